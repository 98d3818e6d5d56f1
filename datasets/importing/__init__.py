"""Import of a dataset as logs: `run`; `guard` for importers of others, `files` for what importers share."""
