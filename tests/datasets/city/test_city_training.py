from fbench.datasets.city.conditions import CONDITIONS
from fbench.datasets.city.suite import SEEDS
from fbench.datasets.city.training import HELD_OUT, training_logs


def test_training_sees_all_weathers_of_both_worlds_and_no_test_seed():
    specs = dict(training_logs())
    assert len(specs) == 2 * 10 * 7
    assert {spec.condition.name for spec in specs.values()} == set(CONDITIONS)
    assert {spec.seed for spec in specs.values()} == set(SEEDS["dev"]) - {HELD_OUT}
    assert not {spec.seed for spec in specs.values()} & set(SEEDS["test"])
    assert len({spec.log_id for spec in specs.values()}) == len(specs)


def test_logs_are_named_by_what_they_show():
    specs = dict(training_logs())
    assert specs["urban-fog-103"].world == "urban"
    assert specs["urban-fog-103"].condition == CONDITIONS["fog"]
    assert set(specs["urban-fog-103"].rig.names) == {"front", "rear", "left", "right"}
