from collections import Counter

from fbench.datasets.city.request import DEMO_SEEDS, SEEDS, TRAINING_SEEDS, training_logs
from fbench.datasets.city.spec import CONDITIONS


def test_training_sees_no_seed_that_figures_or_thresholds_come_from():
    specs = [spec for _, spec in training_logs()]
    assert {spec.seed for spec in specs} == set(TRAINING_SEEDS)
    assert not set(TRAINING_SEEDS) & {*SEEDS["dev"], *SEEDS["test"], *DEMO_SEEDS["urban"], *DEMO_SEEDS["highway"]}


def test_each_drive_has_a_world_of_its_own():
    specs = [spec for _, spec in training_logs()]
    assert Counter(spec.world for spec in specs) == {"urban": 70, "highway": 70}
    assert len({(spec.world, spec.seed) for spec in specs}) == len({spec.log_id for spec in specs}) == len(specs)


def test_training_sees_all_weathers_in_both_densities_of_traffic():
    specs = [spec for _, spec in training_logs()]
    weathers = {name: one.weather for name, one in CONDITIONS.items() if not one.is_dense}
    for world in ("urban", "highway"):
        seen = Counter((s.condition.weather, s.condition.is_dense) for s in specs if s.world == world)
        twice = {name: 2 if name == "night" else 1 for name in weathers}
        expected = {(weathers[name], dense): (3 if dense else 4) * num
                    for name, num in twice.items() for dense in (False, True)}  # fmt: skip
        assert seen == expected


def test_logs_are_named_by_what_they_show():
    specs = dict(training_logs())
    assert (specs["urban-fog-302"].world, specs["urban-fog-302"].seed) == ("urban", 302)
    assert specs["urban-fog-302"].condition == CONDITIONS["fog"]
    assert specs["highway-traffic-311"].condition == CONDITIONS["traffic"]
    assert specs["highway-traffic+fog-312"].condition.weather == CONDITIONS["fog"].weather
    assert set(specs["urban-fog-302"].rig.names) == {"front", "rear", "left", "right"}


def test_four_cameras_look_ahead_back_and_to_the_sides():
    for _, spec in training_logs():
        cameras = {name: (c.translation_m, c.yaw_pitch_roll_deg) for name, c in spec.rig.cameras.items()}
        assert cameras == {
            "front": ((2.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
            "rear": ((-2.0, 0.0, 1.2), (180.0, 0.0, 0.0)),
            "left": ((0.5, 0.8, 1.4), (60.0, 0.0, 0.0)),
            "right": ((0.5, -0.8, 1.6), (-60.0, 0.0, 0.0)),
        }
