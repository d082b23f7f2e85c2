"""One checker that every noise model passes, whatever made it."""

import numpy as np
import pytest

from bayes_rs.errors import InputError, NoiseMismatchError
from bayes_rs.noise.file import load_noise
from bayes_rs.noise.noise import Noise


def check_arrays(noise, scan):
    """Check shapes, symmetry and positive semi-definiteness."""
    n_state, n_beam = len(noise), scan.n_beam
    assert noise.n_state == n_state
    assert noise.bias.shape == (n_state, n_beam)
    assert noise.gain.shape == (n_state, n_beam, 6)
    assert noise.covariance.shape == (n_state, n_beam, n_beam)
    assert noise.beam.tolist() == scan.beam.tolist()
    assert noise.relative_error.shape == (n_state, n_beam)
    assert np.all(noise.relative_error > 0.0)
    assert np.all(np.abs(noise.correlation) <= 1.0 + 1e-12)
    assert all(len(getattr(noise, name)) == n_state for name in ("wind_speed", "yaw", "length_scale", "gamma"))
    assert (noise.length_scale[0], noise.gamma[0]) == (noise.turbulence.length_scale, noise.turbulence.gamma)
    for covariance in noise.covariance:
        size = np.abs(covariance).max()
        np.testing.assert_allclose(covariance, covariance.T, rtol=0.0, atol=1e-12 * size)  # rounding
        eigenvalues = np.linalg.eigvalsh(covariance)
        assert eigenvalues[0] > -64.0 * n_beam * np.finfo(float).eps * eigenvalues[-1]
        with pytest.raises(ValueError, match="read-only"):
            covariance[0, 0] = 1.0


def check_noise(noise, scan, folder):
    """Check the arrays, the states, selection, the scan it belongs to, and saving."""
    check_arrays(noise, scan)
    states = [noise.state(index) for index in range(len(noise))]
    assert all(len(state) == 1 for state in states)
    assert Noise.join(states).to_dataset().identical(noise.to_dataset())

    backwards = scan.beam[::-1]
    turned = noise.select(backwards)
    turned.check_scan(scan.select(backwards))
    np.testing.assert_array_equal(turned.covariance, noise.covariance[:, ::-1, ::-1])
    np.testing.assert_array_equal(turned.gain, noise.gain[:, ::-1])
    np.testing.assert_array_equal(turned.bias, noise.bias[:, ::-1])
    with pytest.raises(InputError, match="Unknown beam 99999 in the noise of scan"):
        noise.select([99999])

    noise.check_scan(scan)
    noise.check_scan(scan.with_yaw(1.0))  # yaw is a state of the flow, not of the scan
    if scan.n_beam > 1:
        with pytest.raises(NoiseMismatchError, match="the beams are"):
            noise.check_scan(scan.select(scan.beam[:1]))

    records = noise.for_records([3.0, 10.0], [0.0, 0.1])
    assert records.bias.shape == (2, scan.n_beam)
    assert records.covariance.shape == (2, scan.n_beam, scan.n_beam)
    assert records.gain.shape == (2, scan.n_beam, 6)
    if noise.net is not None:
        for matrix in records.covariance:
            lowest, highest = np.linalg.eigvalsh(matrix)[[0, -1]]
            assert lowest > -64.0 * scan.n_beam * np.finfo(float).eps * highest
        at_states = noise.for_records(noise.wind_speed, noise.yaw, length_scale=noise.length_scale, gamma=noise.gamma)
        np.testing.assert_array_equal(at_states.covariance, noise.covariance)
        np.testing.assert_array_equal(at_states.bias, noise.bias)
        np.testing.assert_allclose(at_states.gain, noise.gain, atol=1e-7)  # geometry and rounding
        assert not at_states.outside.any()
    else:
        np.testing.assert_array_equal(records.covariance, noise.covariance[records.state])
        np.testing.assert_array_equal(records.wind_speed, noise.wind_speed[records.state])

    noise.save(folder / "noise.nc")
    again = load_noise(folder / "noise.nc")
    assert again.to_dataset().identical(noise.to_dataset())
    assert (again.details, again.state_details) == (noise.details, noise.state_details)
