"""`python -m bayes_rs` is `bayes-rs`."""

from bayes_rs.cli import main

main()
