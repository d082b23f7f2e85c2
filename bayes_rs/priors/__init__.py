"""The family of priors: one interface, one module per prior. `bayes_rs.prior` finds them by name."""
