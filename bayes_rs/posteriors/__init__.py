"""The posterior of R for a batch of records: nuisances, proposals, samplers, diagnostics."""
