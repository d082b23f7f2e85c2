"""One checker that every noise model passes, whatever made it."""

import numpy as np
import pytest

from bayes_rs.errors import InputError, NoiseMismatchError
from bayes_rs.noise.model import NoiseBank
from bayes_rs.noise.reading import load_noise


def check_noise(noise, scan, folder):
    """Check shapes, symmetry, positive semi-definiteness, selection, the scan it belongs to, and saving."""
    models = noise.models
    for model in models:
        n_beam = scan.n_beam
        assert model.bias.shape == (n_beam,)
        assert model.gain.shape == (n_beam, 6)
        assert model.covariance.shape == (n_beam, n_beam)
        assert model.beam.tolist() == scan.beam.tolist()
        size = np.abs(model.covariance).max()
        np.testing.assert_allclose(model.covariance, model.covariance.T, rtol=0.0, atol=1e-12 * size)  # rounding
        eigenvalues = np.linalg.eigvalsh(model.covariance)
        assert eigenvalues[0] > -64.0 * n_beam * np.finfo(float).eps * eigenvalues[-1]
        assert np.all(model.relative_error > 0.0)
        assert np.all(np.abs(model.correlation) <= 1.0 + 1e-12)
        with pytest.raises(ValueError, match="read-only"):
            model.covariance[0, 0] = 1.0

    backwards = scan.beam[::-1]
    turned = noise.select(backwards)
    turned.check_scan(scan.select(backwards))
    turned_models = turned.models
    for model, other in zip(models, turned_models, strict=True):
        np.testing.assert_array_equal(other.covariance, model.covariance[::-1, ::-1])
        np.testing.assert_array_equal(other.gain, model.gain[::-1])
        np.testing.assert_array_equal(other.bias, model.bias[::-1])
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
    if isinstance(noise, NoiseBank) and noise.net is not None:
        for matrix in records.covariance:
            lowest, highest = np.linalg.eigvalsh(matrix)[[0, -1]]
            assert lowest > -64.0 * scan.n_beam * np.finfo(float).eps * highest
        at_states = noise.for_records(noise.wind_speed, noise.yaw, length_scale=noise.length_scale, gamma=noise.gamma)
        for index, model in enumerate(models):
            np.testing.assert_array_equal(at_states.covariance[index], model.covariance)
            np.testing.assert_array_equal(at_states.bias[index], model.bias)
            np.testing.assert_allclose(at_states.gain[index], model.gain, atol=1e-7)  # geometry and rounding
        assert not at_states.outside.any()
    else:
        for index, state in enumerate(records.state):
            np.testing.assert_array_equal(records.covariance[index], models[state].covariance)
            assert records.wind_speed[index] == models[state].wind_speed

    noise.save(folder / "noise.nc")
    again = load_noise(folder / "noise.nc")
    assert type(again) is type(noise)
    assert again.to_dataset().identical(noise.to_dataset())
    assert dict(models[0].details) == dict(again.models[0].details)
