"""Mann turbulence: its parameters, presets, stresses, and the way back from stresses."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_rs.errors import InputError
from bayes_rs.geometry.stress import unpack_stress
from bayes_rs.models import preset_names
from bayes_rs.turbulence.mann import MannTurbulence, fit_turbulence, load_turbulence


class TestParameters:
    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"dissipation": 0.0}, r"Invalid dissipation 0.0 m\^\(4/3\) s\^-2 in turbulence 'unnamed'"),
            ({"length_scale": -1.0}, "Invalid length_scale -1.0 m"),
            ({"gamma": -0.1}, "Invalid gamma -0.1"),
            ({"gamma": np.nan}, "Invalid gamma nan"),
        ],
    )
    def test_refuses_what_cannot_be(self, change, message):
        with pytest.raises(InputError, match=message):
            MannTurbulence(**({"dissipation": 0.05, "length_scale": 61.0, "gamma": 3.2} | change))


class TestPresets:
    @pytest.mark.parametrize("name", preset_names("turbulence"))
    def test_every_preset_loads_and_names_its_source(self, name):
        turbulence = load_turbulence(name)
        assert turbulence.name == name
        assert len(turbulence.source) > 20
        assert turbulence.stresses()[4] < 0.0

    @pytest.mark.parametrize(("name", "intensity"), [("iec-a", 0.16), ("iec-b", 0.14), ("iec-c", 0.12)])
    def test_iec_classes_have_the_standard_deviation_that_the_standard_asks_for(self, name, intensity):
        wanted = intensity * (0.75 * 10.0 + 5.6)
        found = np.sqrt(load_turbulence(name).stresses()[0])
        np.testing.assert_allclose(found, wanted, rtol=0.015)  # 0.55 in the standard is itself rounded

    def test_unknown_name(self):
        with pytest.raises(InputError, match="No preset 'calm' in models/turbulence: use one of fu-2022, iec-a"):
            load_turbulence("calm")

    def test_unknown_key(self, tmp_path):
        path = tmp_path / "t.toml"
        path.write_text('title="t"\nsource="s"\ndissipation=1.0\nlength_scale=1.0\ngamma=1.0\nshear=2.0\n')
        with pytest.raises(InputError, match=r"Invalid turbulence file .*: shear"):
            load_turbulence(path)


class TestStresses:
    def test_seed_flow(self):
        turbulence = load_turbulence("fu-2022")
        np.testing.assert_allclose(
            turbulence.stresses() / turbulence.velocity_scale**2,
            [1.772223, 1.031188, 0.639952, 0.0, -0.464883, 0.0],
            atol=1e-6,
        )

    def test_dissipation_and_length_only_scale(self):
        one = MannTurbulence(dissipation=0.01, length_scale=8.0, gamma=3.2)
        two = MannTurbulence(dissipation=0.04, length_scale=8.0, gamma=3.2)
        np.testing.assert_allclose(4.0 * one.stresses(), two.stresses(), rtol=1e-14)
        assert one.velocity_scale == pytest.approx(0.2)


class TestFit:
    @pytest.mark.parametrize("gamma", [1.0, 3.2, 6.0])
    def test_returns_what_the_stresses_came_from(self, gamma):
        turbulence = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=gamma)
        found = fit_turbulence(turbulence.stresses(), length_scale=61.0)
        np.testing.assert_allclose([found.gamma, found.dissipation], [gamma, 0.05], rtol=1e-8)

    def test_length_scale_trades_against_dissipation(self):
        stress = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=1.0).stresses()
        found = fit_turbulence(stress, length_scale=8.0 * 61.0)
        np.testing.assert_allclose([found.gamma, found.dissipation], [1.0, 0.05 / 4.0], rtol=1e-8)

    def test_states_the_misfit_of_stresses_that_are_not_the_models(self):
        found = fit_turbulence([1.0, 1.0, 1.0, 0.5, 0.0, 0.0], length_scale=50.0)
        assert found.gamma < 1e-3
        assert "relative misfit 0.38" in found.source  # 0.5 sqrt(2) / sqrt(3.5)

    def test_the_misfit_is_the_frobenius_norm_of_the_whole_tensor(self):
        stress = np.array([1.4, 0.9, 0.5, 0.3, -0.3, 0.2])
        found = fit_turbulence(stress, length_scale=50.0)
        miss = np.linalg.norm(unpack_stress(stress - found.stresses())) / np.linalg.norm(unpack_stress(stress))
        assert f"relative misfit {miss:.2g}" in found.source
        for gamma in (0.98 * found.gamma, 1.02 * found.gamma):  # and it is the smallest
            other = replace(found, gamma=gamma).stresses()
            other *= np.sum(unpack_stress(stress) * unpack_stress(other)) / np.sum(unpack_stress(other) ** 2)
            assert np.linalg.norm(unpack_stress(stress - other)) > miss * np.linalg.norm(unpack_stress(stress))

    def test_refuses_a_tensor_that_is_not_realizable(self):
        with pytest.raises(InputError, match="the tensor must be positive semi-definite and not zero"):
            fit_turbulence([1.0, 1.0, 1.0, 1.5, 0.0, 0.0], length_scale=50.0)

    def test_refuses_more_anisotropy_than_the_model_has(self):
        with pytest.raises(InputError, match=r"No turbulence fits the stress .*: gamma would be above 15"):
            fit_turbulence([1.0, 1e-3, 1e-4, 0.0, -1e-4, 0.0], length_scale=50.0)


class TestNeutralPresets:
    """The neutral presets against the spectra of Kaimal et al. (1972), which they were fitted to."""

    @pytest.mark.parametrize(("name", "roughness"), [("neutral-onshore", 0.05), ("neutral-offshore", 0.0002)])
    def test_spectra_are_those_of_kaimal(self, name, roughness):
        height, wind_speed = 100.0, 10.0
        friction_velocity = 0.4 * wind_speed / np.log(height / roughness)
        wave_number = np.logspace(-4.0, 0.0, 25)
        n = wave_number * height / (2.0 * np.pi)
        spectra = wave_number[:, None] * load_turbulence(name).spectra(wave_number).real / friction_velocity**2
        # two-sided, so half of n S(n)/u*²
        along = 0.5 * 102.0 * n / (1.0 + 33.0 * n) ** (5.0 / 3.0)
        lateral = 0.5 * 17.0 * n / (1.0 + 9.5 * n) ** (5.0 / 3.0)
        np.testing.assert_allclose(spectra[:, 0], along, rtol=0.2)  # a three-parameter fit to all three spectra
        inertial = n > 0.4
        np.testing.assert_allclose(spectra[inertial, 1], lateral[inertial], rtol=0.25)
