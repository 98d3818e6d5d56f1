"""nuScenes' benchmarks: `detection` and `tracking`; `settings` holds what they fix."""
