"""The documentation site: nothing is left out of it, nothing in it leads nowhere, and its equations are the code's.

The site itself is built by `make docs`, which takes a minute and needs the group docs.
"""

import importlib.util
import re
import shlex
from pathlib import Path
from types import ModuleType

import click
import numpy as np
import pytest
from scipy import special, stats

import bayes_rs as brs
from bayes_rs.cli.group import commands

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
FLOW = brs.load_turbulence("fu-2022")
WEAK = brs.priors.WeakPrior()


def toctree_entries() -> list[str]:
    blocks = re.findall(r"^```\{toctree\}\n(.*?)^```", (DOCS / "index.md").read_text(), re.MULTILINE | re.DOTALL)
    lines = [line.strip() for block in blocks for line in block.splitlines()]
    return [line for line in lines if line and not line.startswith(":")]


def test_every_page_is_in_the_contents_once():
    pages = {page.stem for page in PAGES} - {"index"}
    assert sorted(toctree_entries()) == sorted(pages | {"notebooks/*", "benchmarks/README", "benchmarks/measured"})


def beside_the_pages(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_public_name_is_in_the_reference_once():
    """The lists are made from the stubs, which are what the package gives; each has its mark on the page."""
    tables = beside_the_pages("api_tables")
    lines = (DOCS / "api.md").read_text(encoding="utf-8").splitlines()
    for subject in tables.SUBJECTS:
        assert lines.count(tables.mark(subject)) == 1, subject
        module = importlib.import_module(tables.place_of(subject))
        subjects = set() if subject else set(tables.SUBJECTS)
        assert set(tables.names_in(subject)) == set(module.__all__) - subjects, subject
    text = "\n".join([*lines, *map(tables.names_of, tables.SUBJECTS)])
    listed = re.findall(r"^   ~bayes_rs\.([\w.]+)$", text, re.MULTILINE)
    assert len(listed) == len(set(listed))
    for subject in tables.SUBJECTS:
        for name in tables.names_in(subject):
            place = f"{subject}.{name}" if subject else name
            assert place in listed or name in listed or f"`{name}`" in text or f"bayes_rs.{name}`" in text, place


def anchors(page: Path) -> set[str]:
    """Anchors as GitHub and MyST make them of headings."""
    headings = re.findall(r"^#+ (.*)$", FENCE.sub("", page.read_text()), re.MULTILINE)
    kept = (re.sub(r"[^\w\- ]", "", re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading)) for heading in headings)
    return {heading.strip().lower().replace(" ", "-") for heading in kept}


@pytest.mark.parametrize(
    "page", [*PAGES, ROOT / "README.md", *sorted((ROOT / "benchmarks").glob("*.md"))], ids=lambda p: p.stem
)
def test_links_lead_somewhere(page):
    text = FENCE.sub("", page.read_text())
    for target in re.findall(r"\]\(<?([^)>\s]+)", text):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        place = (page.parent / file).resolve() if file else page
        assert place.exists(), f"{page.name}: {target}"
        if anchor:
            assert anchor in anchors(place), f"{page.name}: {target}"


def shell_lines() -> list[tuple[str, str]]:
    found = []
    for page in [*PAGES, ROOT / "README.md"]:
        for block in re.findall(r"^```sh\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL):
            lines = [line.strip() for line in block.replace("\\\n", " ").splitlines()]
            found += [(page.name, line) for line in lines if line.startswith("bayes-rs ")]
    return found


@pytest.mark.parametrize(("page", "line"), shell_lines())
def test_commands_and_their_options_exist(page, line):
    _, name, *words = shlex.split(line, comments=True)
    command = commands.get_command(click.Context(commands), name)
    assert command is not None, f"{page}: {line}"
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    used = {word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word)}
    assert used <= known | {"--help"}, f"{page}: {line}"


def test_the_field_guide_prints_what_compare_finds():
    """A width of 128 records is the same for the same seed; printed to a hundredth, shares to a tenth."""
    text = (DOCS / "instruments.md").read_text()
    scans = ["staring", "4-beam", "6-beam", "50-beam"]
    table = brs.compare(scans, seed=1)
    table = table[table["estimator"] == "posterior"].set_index(["scan", "stress"])
    for scan in scans:
        cells = next(line for line in text.splitlines() if line.startswith(f"| `{scan}` |")).split("|")[2:-1]
        assert int(cells[0]) == brs.geometry.sight(brs.load_scan(scan)).rank
        for stress, cell in zip(brs.STRESSES, cells[1:-1], strict=True):
            width, decided = (float(number) for number in re.findall(r"-?[\d.]+", cell.replace("−", "-")))
            assert width == pytest.approx(table.loc[(scan, stress), "width_ratio"], abs=0.0051)
            assert decided == pytest.approx(table.loc[(scan, stress), "decided"], abs=0.0501)


def decided_by_hand(posterior, prior):
    """The two equations of docs/science.md, from draws of both, each (n, 6)."""

    def coordinates(stress):
        uu, vv, ww, uv, uw, vw = stress.T
        rho_uv, rho_uw, rho_vw = uv / np.sqrt(uu * vv), uw / np.sqrt(uu * ww), vw / np.sqrt(vv * ww)
        partial = (rho_vw - rho_uv * rho_uw) / np.sqrt((1 - rho_uv**2) * (1 - rho_uw**2))
        found = [np.log(uu), np.log(vv / uu), np.log(ww / uu), *map(np.arctanh, (rho_uv, rho_uw, partial))]
        return (np.transpose(found) - [0, np.log(WEAK.ratio_vv), np.log(WEAK.ratio_ww), 0, WEAK.z_uw, 0]) / sd

    sd = np.array([WEAK.log_sd_uu, WEAK.log_sd_vv, WEAK.log_sd_ww, *[WEAK.z_sd] * 3])
    pairs = [(0, 1), (0, 2), (1, 2)]
    z, z_prior = coordinates(posterior), coordinates(prior)
    log_uu, log_vv, log_ww = np.log(prior[:, :3]).T
    relative = prior / prior[:, :1]
    room, weight = (
        [np.std(log_uu - np.log(prior[:, 1] + prior[:, 2])), np.std(log_vv - log_uu), np.std(log_ww - log_uu)],
        [],
    )
    for (i, j), column in zip(pairs, (3, 4, 5), strict=True):
        q = relative[:, column] / np.sqrt(relative[:, i] * relative[:, j]).mean()
        room.append(np.linalg.norm([np.cov(q, one)[0, 1] for one in z_prior.T[1:]]))
    for index in range(6):
        one = pairs[index - 3]
        size = np.sqrt(posterior[:, one[0]] * posterior[:, one[1]]).mean()
        q = np.log(posterior[:, index]) if index < 3 else posterior[:, index] / size
        moved = [np.cov(q, one)[0, 1] for one in z.T]
        weight.append(max(abs(moved[0]) / sd[0], np.linalg.norm(moved[1:]) / room[index]))
    return 1 - np.array(weight), 6 - z.var(axis=0).sum()


class TestScience:
    """The equations of docs/science.md, written out once more by hand."""

    def test_beams_and_the_forward_model(self):
        opening, phase = 0.4, 1.1
        scan = brs.load_scan("6-beam", opening_angle_deg=np.rad2deg(opening))
        phases = np.deg2rad(90.0) + 2.0 * np.pi * np.arange(5) / 5.0
        by_hand = [[-np.cos(opening), np.cos(t) * np.sin(opening), np.sin(t) * np.sin(opening)] for t in phases]
        np.testing.assert_allclose(scan.line_of_sight[:5], by_hand, atol=1e-15)
        n = np.array([-np.cos(opening), np.cos(phase) * np.sin(opening), np.sin(phase) * np.sin(opening)])
        stress = np.array([1.2, 0.7, 0.4, 0.1, -0.3, 0.05])
        tensor = stress[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
        a = [n[0] ** 2, n[1] ** 2, n[2] ** 2, 2 * n[0] * n[1], 2 * n[0] * n[2], 2 * n[1] * n[2]]
        np.testing.assert_allclose(brs.geometry.radial_variance([n], stress), [n @ tensor @ n], rtol=1e-14)
        np.testing.assert_allclose(brs.geometry.design_matrix([n]), [a], rtol=1e-14)

    def test_what_a_cone_cannot_see(self):
        cot2 = 1.0 / np.tan(np.deg2rad(15.0)) ** 2
        unseen = brs.geometry.sight(brs.load_scan("50-beam")).unseen
        np.testing.assert_allclose(unseen, [[1.0, -cot2, -cot2, 0.0, 0.0, 0.0]], atol=1e-9)
        assert round(cot2, 1) == 13.9

    def test_spectrum_and_lifetime(self):
        """The isotropic tensor is E/(4π k⁴)(k² δ − k k); the stresses are its integral, by the trace ∫E dk = 3/2 uu."""
        k = np.array([0.01, 0.03, -0.02])
        size = np.linalg.norm(k)
        isotropic = brs.MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=0.0)
        kl = size * 61.0
        energy = 0.05 * 61.0 ** (5 / 3) * kl**4 / (1.0 + kl**2) ** (17 / 6)
        expected = energy / (4.0 * np.pi * size**4) * (size**2 * np.eye(3) - np.outer(k, k))
        np.testing.assert_allclose(isotropic.spectral_tensor(k), expected, rtol=1e-12)
        # under shear k₀ = (k₁, k₂, k₃ + βk₁) becomes k, and w grows by k₀²/k², whatever u and v do
        beta = 3.2 * kl ** (-2 / 3) / np.sqrt(special.hyp2f1(1 / 3, 17 / 6, 4 / 3, -(kl**-2.0)))
        k1, k2, k3 = k
        k0 = np.array([k1, k2, k3 + beta * k1])
        squeeze = (k0 @ k0) / (k @ k)
        k0l = np.linalg.norm(k0) * 61.0
        e0 = 0.05 * 61.0 ** (5 / 3) * k0l**4 / (1.0 + k0l**2) ** (17 / 6)
        initial_ww = e0 / (4.0 * np.pi * (k0 @ k0) ** 2) * (k1**2 + k2**2)
        sheared = brs.MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2)
        assert sheared.spectral_tensor(k)[2, 2] == pytest.approx(squeeze**2 * initial_ww, rel=1e-10)

    def test_noise_by_isserlis(self):
        """Dense matrices of every sample's covariance, for two beams, forty samples and a yaw of zero."""
        scan = brs.load_scan("2-beam")
        duration, speed = 40.0, 8.0
        noise = brs.noise.theory(scan, FLOW, wind_speed=speed, duration=duration, tolerance=2e-5)
        n, place = scan.line_of_sight, scan.focus_distance[:, None] * scan.line_of_sight
        time = [scan.beam_time[b] + scan.scan_duration * np.arange(40) for b in (0, 1)]
        centre = np.eye(40) - 1.0 / 40.0

        def covariance(a: int, b: int) -> np.ndarray:
            lag = time[b][None, :] - time[a][:, None]
            apart = (place[b] - place[a]) - speed * lag[..., None] * np.array([1.0, 0.0, 0.0])
            return np.einsum(
                "i,...ij,j->...", n[a], brs.turbulence.velocity_covariance(apart, FLOW, tolerance=2e-5), n[b]
            )

        mean = [np.trace(centre @ covariance(b, b) @ centre) / 40.0 for b in (0, 1)]
        cross = 2.0 * np.linalg.norm(centre @ covariance(0, 1) @ centre) ** 2 / 40.0**2
        own = 2.0 * np.linalg.norm(centre @ covariance(0, 0) @ centre) ** 2 / 40.0**2
        variances = brs.geometry.radial_variance(scan, FLOW.stresses())
        # covariances are within 2e-5 of uu, variances of 40 s a third of it, K counts them twice
        np.testing.assert_allclose(noise.bias[0], np.array(mean) / variances - 1.0, atol=2e-4)
        assert noise.covariance[0, 0, 1] == pytest.approx(cross / (mean[0] * mean[1]), rel=5e-4)
        assert noise.covariance[0, 0, 0] == pytest.approx(own / mean[0] ** 2, rel=5e-4)

    def test_log_normal_likelihood(self):
        """With as many beams as stresses nothing is reduced: the posterior over the prior is the normal of ln y."""
        scan = brs.load_scan("6-beam", opening_angle_deg=45.0)
        noise = brs.noise.calibrate(scan, FLOW, wind_speed=10.0, cache=False)
        c = np.log1p(noise.covariance[0])
        truth = np.array([1.2, 0.8, 0.5, 0.0, -0.3, 0.0])
        records = brs.make_records(brs.simulate(scan, FLOW, wind_speed=10.0, n_records=1, seed=3), scan).assign_coords(
            time=("record", np.array(["2020-01-01"], dtype="datetime64[ns]"))
        )
        y = records["variance"].values[0]

        def log_likelihood(stress: np.ndarray) -> np.ndarray:
            m = stress @ brs.geometry.design_matrix(scan).T
            return stats.multivariate_normal(np.zeros(6), c).logpdf(np.log(y) - np.log(m) + 0.5 * np.diag(c))

        # importance weights of the prior by hand, against the mean that the fit finds
        prior = brs.priors.make_prior("weak:log_sd_uu=0.3")
        draws = prior.draw(400_000, seed=5)
        weight = np.exp(log_likelihood(draws) - log_likelihood(truth))
        weight /= weight.sum()
        by_hand = weight @ draws
        error = np.sqrt(weight**2 @ (draws - by_hand) ** 2)
        records["yaw"] = ("record", [0.0])  # the noise is for yaw 0
        table = brs.fit(
            records, scan, noise=noise, prior=prior, seed=1, sampler="direct", target_ess=4000, instrument_noise=0.0
        ).summary()
        gap = table["mean"].to_numpy() - by_hand
        assert (np.abs(gap) < 4.5 * np.hypot(error, table["mcse_mean"].to_numpy())).all()

    def test_prior_weak(self):
        z = np.array([0.3, -0.7, 1.1, 0.4, -1.2, 0.9])
        uu = np.exp(2.0 * z[0])
        vv, ww = uu * 0.64 * np.exp(0.5 * z[1]), uu * 0.4 * np.exp(0.9 * z[2])
        uv, uw, partial = np.tanh(0.35 * z[3]), np.tanh(-0.3 + 0.35 * z[4]), np.tanh(0.35 * z[5])
        vw = uv * uw + partial * np.sqrt((1.0 - uv**2) * (1.0 - uw**2))
        by_hand = [uu, vv, ww, uv * np.sqrt(uu * vv), uw * np.sqrt(uu * ww), vw * np.sqrt(vv * ww)]
        np.testing.assert_allclose(brs.priors.make_prior("weak").stress(z), by_hand, rtol=1e-13)

    def test_probes(self):
        probe = brs.geometry.ContinuousWaveProbe(wavelength=1.565e-6, aperture_radius=0.028)
        z_r = 1.565e-6 * 98.0**2 / (np.pi * 0.028**2)
        assert float(probe.transfer(-0.1, 98.0)) == pytest.approx(np.exp(-z_r * 0.1), rel=1e-14)

    def test_what_the_data_decided_and_what_is_derived(self):
        scan = brs.load_scan("6-beam", opening_angle_deg=45.0)
        noise = brs.noise.calibrate(scan, FLOW, wind_speed=10.0, cache=False)
        records = brs.make_records(brs.simulate(scan, FLOW, wind_speed=10.0, n_records=1, seed=3), scan)
        result = brs.fit(records, scan, noise=noise, seed=1, sampler="direct", instrument_noise=0.0)
        posterior = result["posterior/stress"].values.reshape(-1, 6)
        prior = result["prior/stress"].values.reshape(-1, 6)
        table = result.summary(derived=["tke", "friction_velocity", "ti"]).set_index("stress")
        names = list(brs.STRESSES)
        decided, learnt = decided_by_hand(posterior, prior)
        # of the square of a part the bias from Monte-Carlo errors is left in by hand
        np.testing.assert_allclose(table.loc[names, "decided"].to_numpy(dtype=float), decided, atol=0.03)
        assert result.table("posterior")["stresses_learnt"].item() == pytest.approx(learnt, abs=0.01)
        assert table.loc["tke", "mean"] == pytest.approx(0.5 * posterior[:, :3].sum(axis=1).mean(), rel=1e-9)
        friction = (posterior[:, 4] ** 2 + posterior[:, 5] ** 2) ** 0.25
        assert table.loc["friction_velocity", "mean"] == pytest.approx(friction.mean(), rel=1e-9)
        speed = float(records["wind_speed"][0])
        assert table.loc["ti", "mean"] == pytest.approx((np.sqrt(posterior[:, 0]) / speed).mean(), rel=1e-9)

    def test_ensemble_target(self):
        scan = brs.load_scan("6-beam", opening_angle_deg=45.0)
        noise = brs.noise.calibrate(scan, FLOW, wind_speed=10.0, cache=False)
        records = brs.make_records(brs.simulate(scan, FLOW, wind_speed=10.0, n_records=20, seed=3), scan)
        records["yaw"] = records["yaw"] * 0.0  # the noise is for yaw 0
        result = brs.fit(records, scan, noise=noise, seed=1, sampler="direct", target="ensemble")
        predicted = result["posterior_predictive/variance"].mean(("chain", "draw")).transpose("record", "beam").values
        mean = result["posterior/stress"].mean(("chain", "draw")).transpose("record", "component").values
        expected = (mean @ noise.gain[0].T) * (1.0 + noise.bias[0])
        # twenty means of a hundred and more draws that scatter by a third: 1 %, where the bias is 12 %
        np.testing.assert_allclose((predicted / expected).mean(axis=0), 1.0, atol=0.035)
