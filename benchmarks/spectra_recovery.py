"""How well spectra give back length scales and instrument noise that were put in: the tables of docs/spectra.md.

Run: python benchmarks/spectra_recovery.py
"""

from dataclasses import replace

import numpy as np

import bayes_rs as brs
from bayes_rs.spectra.beam_theory import scaled_autocovariance
from bayes_rs.spectra.lag_window import lag_windows, ordinate_correlation

NINETY = 1.6449


def noisy_spectra(scan, flow, speed, n_records, noise, seed):
    """Return the spectra of simulated records with white noise added, and the records."""
    series = brs.simulate(scan, flow, wind_speed=speed, n_records=n_records, seed=seed)
    white = np.sqrt(noise) * np.random.default_rng(seed).standard_normal(series.sizes["sample"])
    series = series.assign(radial_velocity=series["radial_velocity"] + white)
    return brs.spectra.radial_spectra(series, scan, brs.make_records(series, scan))


def holds(fit, truth):
    """Return which records' central 90 % intervals of ln L hold the truth, from the posterior on its grid."""
    node = np.log(fit["length_node"].values)
    median, width = fit.attrs["length_scale_prior"]
    density = fit["log_density"].values[:, 0] - 0.5 * ((node - np.log(median)) / width) ** 2
    weight = np.exp(density - density.max(axis=1, keepdims=True))
    below = np.cumsum(weight, axis=1) / weight.sum(axis=1, keepdims=True)
    half = 0.5 * (node[1] - node[0])
    at = np.array([np.interp(np.log(truth), node + half, row) for row in below])
    return (at > 0.05) & (at < 0.95)


def length_scales(n_records=150):
    """Print how the length scale is recovered, record by record and pooled."""
    print(
        "| scan | interval, s | flow | L, m | U, m/s | noise | mean error of ln L | scatter | stated sd | 90 % hold "
        "| pooled L, m |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for name, flow_name, speed, noise in (
        ("staring", "fu-2022", 10.0, 0.0),
        ("staring", "fu-2022", 10.0, 0.1),
        ("staring", "stable-offshore", 8.0, 0.0),
        ("staring", "unstable-offshore", 12.0, 0.0),
        ("pulsed-4-beam", "fu-2022", 10.0, 0.0),
        ("pulsed-4-beam", "fu-2022", 10.0, 0.1),
        ("pulsed-4-beam", "neutral-offshore", 10.0, 0.0),
        ("pulsed-4-beam", "stable-offshore", 8.0, 0.0),
        ("6-beam", "fu-2022", 10.0, 0.0),
        ("6-beam", "unstable-offshore", 12.0, 0.0),
    ):
        scan, flow = brs.load_scan(name, probe="point"), brs.load_turbulence(flow_name)
        spectra = noisy_spectra(scan, flow, speed, n_records, noise, seed=11)
        fit = brs.spectra.fit_spectra(spectra, scan, gamma=flow.gamma, progress=False)
        error = np.log(fit["length_scale"].values / flow.length_scale)
        pooled = brs.spectra.pool_length_scale(fit)
        scale, width = float(pooled["length_scale"][0]), float(pooled["length_scale_log_sd"][0])
        print(
            f"| {name} | {spectra.attrs['interval']:g} | {flow_name} | {flow.length_scale:g} | {speed:g} | {noise:g} | "
            f"{error.mean():+.2f} | {error.std():.2f} | {fit['length_scale_log_sd'].values.mean():.2f} | "
            f"{holds(fit, flow.length_scale).mean():.2f} | {scale:.1f}, within {100.0 * width:.0f} % |",
            flush=True,
        )


def record_counts(n_records=400):
    """Print how error and stated width of the pooled length scale go down with the number of records."""
    scan, flow = brs.load_scan("staring"), brs.load_turbulence("fu-2022")
    fit = brs.spectra.fit_spectra(noisy_spectra(scan, flow, 10.0, n_records, 0.0, 12), scan, progress=False)
    print("| records together | groups | mean error of ln L | scatter | stated sd | 90 % hold |")
    print("|---|---|---|---|---|---|")
    for size in (1, 4, 10, 40):
        pooled = brs.spectra.pool_length_scale(fit, np.arange(n_records) // size)
        error, width = np.log(pooled["length_scale"].values / flow.length_scale), pooled["length_scale_log_sd"].values
        print(
            f"| {size} | {len(error)} | {error.mean():+.3f} | {error.std():.3f} | {width.mean():.3f} | "
            f"{(np.abs(error) < NINETY * width).mean():.2f} |",
            flush=True,
        )


def instrument_noise(n_records=200):
    """Print bias, scatter and coverage of the noise from structure functions and from the floor of the spectrum."""
    flow = brs.load_turbulence("fu-2022")
    print("| interval, s | noise | method | mean error | its standard error | scatter | stated sd | 90 % hold |")
    print("|---|---|---|---|---|---|---|---|")
    other = replace(flow, length_scale=30.0)
    for interval in (0.25, 1.0, 4.0):
        scan = replace(brs.load_scan("staring"), scan_duration=interval)
        for noise in (0.0, 0.1):
            spectra = noisy_spectra(scan, flow, 10.0, n_records, noise, seed=13)
            ways = [
                ("structure", "structure, theory", {}, flow),
                ("structure", "structure, 2/3 law", {"growth": "inertial"}, flow),
                ("structure", "structure, theory, L = 30 m", {}, other),
            ]
            if interval >= 1.0:
                ways.append(("spectrum", "floor", {}, flow))
            for method, words, options, taken in ways:
                found = brs.spectra.estimate_instrument_noise(spectra, scan, taken, method=method, **options)
                error = found["instrument_noise"].values[:, 0] - noise
                width = found["instrument_noise_sd"].values[:, 0]
                held, standard_error = (np.abs(error) < NINETY * width).mean(), error.std() / np.sqrt(n_records)
                print(
                    f"| {interval:g} | {noise:g} | {words} | {error.mean():+.4f} | {standard_error:.4f} | "
                    f"{error.std():.4f} | {width.mean():.4f} | {held:.2f} |",
                    flush=True,
                )


def tapers(interval=1.0):
    """Print the bias and the scatter of spectra with and without tapers, against the aliased spectrum, by theory."""
    n = int(600.0 / interval)
    flow, scan = brs.load_turbulence("fu-2022"), brs.load_scan("staring")
    frequency = np.array([1, 2, 5, 20, 100, n // 2 - 1]) / (n * interval)
    far = scaled_autocovariance(
        scan.line_of_sight[0],
        10.0 * interval * np.arange(64 * n),
        np.array([flow.length_scale]),
        gamma=flow.gamma,
        probe=scan.probe,
        probe_length=0.0,
    )[0]
    waves = np.cos(2.0 * np.pi * np.outer(frequency, interval * np.arange(64 * n)))
    weights = np.full(64 * n, 2.0)
    weights[0] = 1.0
    true = 2.0 * interval * (waves * weights) @ far
    print("| tapers | " + " | ".join(f"{value:.4f} Hz" for value in frequency) + " | relative sd of one estimate |")
    print("|---|" + "---|" * (len(frequency) + 1))
    index = np.round(frequency * n * interval).astype(int) - 1
    for count in (0, 1, 3, 5):
        mean = lag_windows(np.ones(n, dtype=bool), interval, count)[index] @ far[:n]
        cells = " | ".join(f"{100.0 * value:+.1f} %" for value in mean / true - 1.0)
        print(f"| {count} | {cells} | {np.sqrt(ordinate_correlation(n, count)[0]):.2f} |")


if __name__ == "__main__":
    tapers()
    record_counts()
    instrument_noise()
    length_scales()
