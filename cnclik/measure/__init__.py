"""Numbers from runs: metrics, outcomes, labelled datasets, files."""
