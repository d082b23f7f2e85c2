"""Boxes of Mann turbulence that have given stresses, for simulators of loads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_array, check_choice, check_finite, check_positive, check_seed
from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import STRESSES, is_realizable, pack_stress, unpack_stress
from bayes_rs.output import output_folder
from bayes_rs.simulation.box_files import FORMATS, WITH_MEAN, BoxToWrite
from bayes_rs.simulation.boxes import BoxGrid, hipersim_for
from bayes_rs.sizes import check_size
from bayes_rs.turbulence.mann import MannTurbulence, as_turbulence

TARGETS = ("record", "ensemble", "sonic")
"""Which tensor the stresses are, as for a fit: about the mean of each line along the wind, or about zero."""
_BYTES_A_POINT = 4 * 80.0  # of hipersim, whose box is twice as wide and high


def export_box(
    stresses: ArrayLike,
    output: str | Path,
    *,
    grid: BoxGrid,
    wind_speed: float,
    seed: int,
    turbulence: MannTurbulence | str | Path = "fu-2022",
    format: str = "hawc2",  # noqa: A002 - the word that everyone uses
    target: str = "record",
    hub_height: float | None = None,
    shear_exponent: float = 0.0,
    overwrite: bool = False,
) -> list[Path]:
    r"""Write a box of Mann turbulence whose stresses are those that are given.

    Parameters
    ----------
    stresses : array_like, shape (6,)
        R: uu, vv, ww, uv, uw, vw, m² s⁻², x along the wind, y to the left, z up; as one draw of a posterior.
    output : str or Path
        Folder to write.
    grid : BoxGrid
        The grid: a length of U times the duration of a record, and at least the rotor in width and height.
    wind_speed : float
        Mean wind speed U, m/s, with which the box is carried past.
    seed : int
        Seed of the box.
    turbulence : MannTurbulence, str or Path
        Length scale and anisotropy of the box; its dissipation plays no part.
    format : str
        ``"hawc2"``, ``"bladed"``, ``"turbsim"`` or ``"netcdf"``.
    target : str
        Which tensor the stresses are, as for a fit: ``"record"`` and ``"sonic"`` are about the mean of each line of the
        box along the wind, ``"ensemble"`` about zero.
    hub_height : float, optional
        Height of the box's centre, m; by default its lowest point is one step above the ground.
    shear_exponent : float
        α of the mean wind U (z / hub height)^α, in files that hold the mean wind (``"turbsim"``). To the others the
        simulator adds it.
    overwrite : bool
        Replace the folder of an earlier run.

    Returns
    -------
    files : list of Path
        What was written: ``box-000u.turb``, ``…v.turb``, ``…w.turb`` and ``box-000.htc``; ``.wnd`` and ``.sum``;
        ``.bts``; or ``.nc``.

    Raises
    ------
    InputError
        If a number is not valid, the stresses are those of no flow, or the box does not fit into memory.
    MissingExtraError
        If hipersim is not installed.

    Notes
    -----
    The velocities of a box u of hipersim are T u with

    .. math:: T = B^{-1/2} \left(B^{1/2} R\, B^{1/2}\right)^{1/2} B^{-1/2}, \qquad T B\, T^\mathsf{T} = R ,

    B being the tensor that this very box has, so that the written one has R exactly, to the format's rounding. Of all
    T with that property it is the one that changes the velocities least in the mean square (Olkin and Pukelsheim 1982);
    it does not depend on the axes, as a Cholesky factor would. With the tensor of the model in place of B, boxes would
    have R on average and scatter about it as records do; here the scatter between boxes is that of the draws.

    The box is not periodic in y and z, as hipersim makes it twice as wide and high and gives a quarter; it is periodic
    in x. Coherences are those of the model where T is diagonal, and near them otherwise. T u is not free of divergence,
    as no box is whose components are scaled.

    References
    ----------
    Mann (1998), Probabilistic Engineering Mechanics 13, 269–282, doi:10.1016/S0266-8920(97)00036-2.
    Olkin and Pukelsheim (1982), Linear Algebra and its Applications 48, 257–263, doi:10.1016/0024-3795(82)90112-4.

    Examples
    --------
    >>> import tempfile
    >>> grid = BoxGrid((64, 8, 8), (10.0, 10.0, 10.0))
    >>> with tempfile.TemporaryDirectory() as place:
    ...     files = export_box([1.4, 0.9, 0.4, 0.1, -0.3, 0.0], f"{place}/box", grid=grid, wind_speed=10.0, seed=1)
    >>> [file.name for file in files]
    ['box-000u.turb', 'box-000v.turb', 'box-000w.turb', 'box-000.htc']
    """
    chosen = BoxOptions(grid, wind_speed, format, target, hub_height, shear_exponent)
    wanted = check_stresses(stresses)
    number, flow = check_seed(seed), as_turbulence(turbulence)
    hipersim_for("")
    final = Path(output)
    with output_folder(final, overwrite=overwrite) as folder:
        files = chosen.write(wanted, flow, number, folder / "box-000")
    return [final / file.name for file in files]


class BoxOptions:
    """What the boxes of one folder share: see `export_box`, which has the parameters."""

    def __init__(
        self,
        grid: BoxGrid,
        wind_speed: float,
        format: str,  # noqa: A002 - as above
        target: str,
        hub_height: float | None,
        shear_exponent: float,
    ) -> None:
        if not isinstance(grid, BoxGrid):
            raise InputError(f"Invalid grid {grid!r}: give bayes_rs.simulation.BoxGrid((n_x, n_y, n_z), (dx, dy, dz)).")
        self.grid = grid
        self.wind_speed = check_positive(wind_speed, what="wind_speed", unit="m/s")
        self.format = check_choice(format, tuple(FORMATS), what="format of a box")
        self.target = check_choice(target, TARGETS, what="target")
        below = 0.5 * grid.spacing[2] * (grid.shape[2] - 1)
        centre = below + grid.spacing[2] if hub_height is None else hub_height
        self.hub_height = check_positive(centre, what="hub_height", unit="m")
        if self.hub_height < below:
            raise InputError(
                f"Invalid hub_height {self.hub_height:g} m: the box reaches {below:g} m below it, into the ground; "
                "give a higher one, or a lower grid."
            )
        self.shear_exponent = check_finite(shear_exponent, what="shear_exponent", unit="")
        if self.shear_exponent and format not in WITH_MEAN:
            raise InputError(
                f"Invalid shear_exponent {shear_exponent:g} with format {format!r}: its files hold no mean wind, and "
                "the simulator adds the shear; leave it out."
            )
        size = "×".join(map(str, grid.shape))
        check_size(f"A box of {size} points", grid.n_point * _BYTES_A_POINT, "give a coarser or smaller grid.")

    def write(self, stresses: FloatArray, turbulence: MannTurbulence, seed: int, stem: Path) -> list[Path]:
        """Make the box of one tensor and seed, and write it; return the files."""
        field = hipersim_for("").MannTurbulenceField.generate(
            alphaepsilon=turbulence.dissipation,
            L=turbulence.length_scale,
            Gamma=turbulence.gamma,
            Nxyz=self.grid.shape,
            dxyz=self.grid.spacing,
            seed=seed,
            HighFreqComp=1,
            double_xyz=(False, True, True),
            n_cpu=1,  # boxes depend on the number of cores
        )
        field.uvw = with_stresses(np.asarray(field.uvw), stresses, target=self.target)
        about: dict[str, Any] = {
            "stresses": stresses,
            "stresses_order": " ".join(STRESSES),
            "target": self.target,
            "wind_speed": self.wind_speed,
            "hub_height": self.hub_height,
        }
        box = BoxToWrite(field, self.grid, self.wind_speed, self.hub_height, self.shear_exponent, about)
        return FORMATS[self.format](box, stem)


def check_stresses(stresses: ArrayLike) -> FloatArray:
    """Return the stresses of a box, checked.

    Raises
    ------
    InputError
        If they are not six numbers, or those of no flow.
    """
    wanted = check_array(stresses, (len(STRESSES),), what="stresses")
    if not is_realizable(wanted) or np.any(wanted[:3] <= 0.0):
        raise InputError(
            f"Invalid stresses {wanted.round(4).tolist()} m² s⁻²: no flow has them, since a principal variance is "
            "below zero, or a variance is zero; give a draw of a posterior."
        )
    return wanted


def with_stresses(velocity: NDArray[Any], stresses: ArrayLike, *, target: str = "record") -> NDArray[np.float32]:
    """Return T u, which has the stresses that are given; see `export_box`.

    Parameters
    ----------
    velocity : ndarray, shape (3, n_x, n_y, n_z)
        u, v, w, m/s.
    stresses : array_like, shape (6,)
        R, m² s⁻².
    target : str
        Which tensor they are.

    Returns
    -------
    velocity : ndarray, shape (3, n_x, n_y, n_z)
        float32; the mean of the box is zero.
    """
    level = velocity - velocity.mean(axis=(1, 2, 3), keepdims=True, dtype=np.float64)  # as Bladed's files have it
    factor = turning_factor(unpack_stress(box_stresses(level, target=target)), unpack_stress(stresses))
    return np.asarray(np.tensordot(factor, level, axes=1), dtype=np.float32)


def box_stresses(velocity: NDArray[Any], *, target: str = "record") -> FloatArray:
    """Return the stresses that a box has.

    Parameters
    ----------
    velocity : ndarray, shape (3, n_x, n_y, n_z)
        u, v, w, m/s.
    target : str
        ``"record"`` and ``"sonic"``: covariances along each line of the box along the wind, about its mean, averaged
        over the lines; ``"ensemble"``: about zero.

    Returns
    -------
    stresses : ndarray, shape (6,)
        uu, vv, ww, uv, uw, vw, m² s⁻².

    Raises
    ------
    InputError
        If there are not three components over three directions, or the target is unknown.

    Examples
    --------
    >>> u = np.zeros((3, 4, 2, 2))
    >>> u[0, :2] = 2.0
    >>> box_stresses(u)[0], box_stresses(u, target="ensemble")[0]
    (np.float64(1.0), np.float64(2.0))
    """
    check_choice(target, TARGETS, what="target")
    wide = check_array(velocity, (3, None, None, None), what="velocity")
    if target != "ensemble":
        wide = wide - wide.mean(axis=1, keepdims=True)
    flat = wide.reshape(3, -1)
    return pack_stress(flat @ flat.T / flat.shape[1])


def turning_factor(has: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the symmetric T with T B Tᵀ = R, shape (3, 3); see `export_box`."""
    root = _root(has)
    inverse = np.linalg.inv(root)
    return np.asarray(inverse @ _root(root @ wanted @ root) @ inverse)


def _root(matrix: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
