"""The ray caster that all sensors share."""
