"""Targets that are known in closed form, and samplers with a planted fault."""

from types import SimpleNamespace

import numpy as np

from bayes_rs.posteriors.proposal import StudentProposal
from bayes_rs.posteriors.sampling import candidates, ensemble, sample
from bayes_rs.posteriors.sampling.effort import Effort


class Target:
    """A density of n_record records in six coordinates, whose stresses are the coordinates themselves."""

    n_coordinate = 6

    def __init__(self, log_density, n_record):
        self._log_density = log_density
        self.n_record = n_record
        self.likelihood = SimpleNamespace(gain=np.zeros((n_record, 1, 6)))

    def log_density(self, coordinate):
        return self._log_density(coordinate)

    def stress(self, coordinate):
        return coordinate.copy()

    def evaluate(self, coordinate):
        return self._log_density(coordinate), coordinate.copy()

    def take(self, records):
        return Target(self._log_density, len(records))


def normal(coordinate):
    return -0.5 * np.sum(coordinate**2, axis=-1)


def two_hills(apart):
    """Two normal hills of equal weight, so many standard deviations apart along the first coordinate."""

    def log_density(coordinate):
        rest = -0.5 * np.sum(coordinate[..., 1:] ** 2, axis=-1)
        first = [-0.5 * (coordinate[..., 0] - side * 0.5 * apart) ** 2 for side in (-1.0, 1.0)]
        return rest + np.logaddexp(*first) - np.log(2.0)

    return log_density


def student(n_record, shift=0.0, narrow=1.0):
    """Return proposals that are off in every coordinate by `shift`/√6, so by `shift` in all, and too narrow."""
    mode = np.full((n_record, 6), shift / np.sqrt(6.0))
    return StudentProposal(mode, np.broadcast_to(narrow * np.eye(6), (n_record, 6, 6)).copy(), 1)


def plant(monkeypatch, *, shift=0.0, narrow=1.0, mends=True, tilt=0.0, only_one=None):
    """Plant faults: a first proposal that is off; no fit to draws; starts with tilted weights, or in one hill only."""

    def faulty(posterior):
        return student(posterior.n_record, shift, narrow)

    for module in (ensemble, __import__("bayes_rs.posteriors.sampling.direct", fromlist=["direct"])):
        monkeypatch.setattr(module, "laplace_proposal", faulty)
    if not mends:
        monkeypatch.setattr(StudentProposal, "fitted_to", lambda self, coordinate, weight: self)  # noqa: ARG005
    if tilt or only_one is not None:
        right = candidates.resampled

        def wrong(weight, offset, n_keep):
            return right(weight * _factor(weight), offset, n_keep)

        def _factor(weight):
            place = _factor.coordinate
            if only_one is None:
                return np.exp(tilt * place).reshape(weight.shape)
            keep = place.reshape(weight.shape) > 0.0
            factor = np.ones(weight.shape)
            factor[:, only_one] = keep[:, only_one]
            return factor

        joined = candidates.Candidates.all_coordinates

        def remembered(self):
            found = joined(self)
            _factor.coordinate = found[:, 0]
            return found

        def weighed(self):
            self.all_coordinates()
            return weigh(self)

        weigh = candidates.Candidates.weight
        monkeypatch.setattr(candidates.Candidates, "all_coordinates", remembered)
        monkeypatch.setattr(candidates.Candidates, "weight", weighed)
        monkeypatch.setattr(ensemble, "resampled", wrong)


def run(log_density, *, sampler="emcee", n_record=32, target_ess=1000, max_extension=0, seed=3):
    keys = np.arange(n_record)
    return sample(sampler, Target(log_density, n_record), keys=keys, effort=Effort(seed, target_ess, max_extension))[0]
