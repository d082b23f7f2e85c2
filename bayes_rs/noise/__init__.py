"""The noise of a record's beam variances, by theory."""
