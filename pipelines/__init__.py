"""Pipelines: `variants/` composes the built-in ones of stages in `sensors/`, `fusion/` and `tracking/`. `baseline/` is
the thesis as written, `external/` runs any program, and `models/` holds detectors and their training."""
