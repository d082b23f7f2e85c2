"""Some random cases of every check; `python tests/stress/long_run.py` runs as many as time allows."""

import pytest
from stress.cases import CHECKS, run

N_SEED = 25
EXPENSIVE = {"posteriors_follow_their_data": 3, "noise_of_random_scenes": 6, "covariances_of_places": 6}


@pytest.mark.parametrize(
    ("name", "seed"), [(name, seed) for name in CHECKS for seed in range(EXPENSIVE.get(name, N_SEED))]
)
def test_case(name, seed):
    run(name, seed)
