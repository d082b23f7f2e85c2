"""The family of priors: one interface, one module per prior. `bayes_rs.priors.registry` finds them by name."""
