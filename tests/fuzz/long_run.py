"""Fuzz for as long as told: `python tests/fuzz/long_run.py --seed 1 --inputs 1000`, of all families or of one."""

import argparse
import sys
import time
import warnings
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from fuzz.families import FAMILIES
from fuzz.frame import try_case


def main() -> None:
    """Try the inputs, print every complaint when it comes, and a table at the end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--family", choices=list(FAMILIES), action="append", help="by default all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--inputs", type=int, default=1000, help="of each family")
    asked = parser.parse_args()
    warnings.simplefilter("default")
    table = ["| family | seed | inputs | complaints | exit codes | most CPU, s |", "|---|---|---|---|---|---|"]
    n_bad = 0
    for family in asked.family or FAMILIES:
        codes, bad, most, n, began = Counter(), 0, 0.0, 0, time.monotonic()
        for case in FAMILIES[family](asked.seed, asked.inputs):
            found = try_case(case)
            n += 1
            codes[found.code] += 1
            most = max(most, found.cpu_seconds)
            if found.complaint:
                bad += 1
                print(
                    f"{found.name}: {found.complaint}\n    {' | '.join(found.output.strip().splitlines()[-6:])[:700]}"
                )
        n_bad += bad
        words = ", ".join(f"{code}: {count}" for code, count in sorted(codes.items(), key=str))
        table.append(f"| {family} | {asked.seed} | {n} | {bad} | {words} | {most:.1f} |")
        print(f"{table[-1]} {time.monotonic() - began:.0f} s", flush=True)
    print("\n".join(table))
    sys.exit(1 if n_bad else 0)


if __name__ == "__main__":
    main()
