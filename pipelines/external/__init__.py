"""Any program as a pipeline, in lockstep over its stdin and stdout."""
