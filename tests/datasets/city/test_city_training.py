from collections import Counter

from fbench.datasets.city.request import DEMO_SEEDS, SEEDS, TRAINING_SEEDS, training_logs
from fbench.datasets.city.rig import thesis_rig
from fbench.datasets.city.spec import CONDITIONS


def test_training_sees_no_seed_that_figures_or_thresholds_come_from():
    specs = [spec for _, spec in training_logs()]
    assert {spec.seed for spec in specs} == set(TRAINING_SEEDS)
    assert not set(TRAINING_SEEDS) & {*SEEDS["dev"], *SEEDS["test"], *DEMO_SEEDS["urban"], *DEMO_SEEDS["highway"]}


def test_each_drive_comes_once_with_normal_and_once_with_dense_traffic():
    specs = [spec for _, spec in training_logs()]
    assert Counter(spec.world for spec in specs) == {"urban": 140, "highway": 140}
    drives = {(spec.world, spec.seed, spec.condition.is_dense) for spec in specs}
    assert len(drives) == len({spec.log_id for spec in specs}) == len({name for name, _ in training_logs()}) == 280


def test_training_sees_all_weathers_in_both_densities_of_traffic():
    specs = [spec for _, spec in training_logs()]
    weathers = {name: one.weather for name, one in CONDITIONS.items() if not one.is_dense}
    for world in ("urban", "highway"):
        seen = Counter((s.condition.weather, s.condition.is_dense) for s in specs if s.world == world)
        twice = {name: 2 if name == "night" else 1 for name in weathers}
        expected = {(weathers[name], dense): 7 * num
                    for name, num in twice.items() for dense in (False, True)}  # fmt: skip
        assert seen == expected


def test_logs_are_named_by_what_they_show():
    specs = dict(training_logs())
    assert (specs["urban-fog-302"].world, specs["urban-fog-302"].seed) == ("urban", 302)
    assert specs["urban-fog-302"].condition == CONDITIONS["fog"]
    assert specs["highway-traffic-308"].condition == CONDITIONS["traffic"]
    assert specs["highway-traffic+fog-309"].condition.weather == CONDITIONS["fog"].weather
    views = {"front", "rear", "left", "right"}
    assert set(specs["urban-fog-302"].rig.names) == {*views, *(f"{name}_radar" for name in views), "lidar"}


def test_points_are_as_dense_as_those_of_the_thesis_and_measured_with_the_images():
    thesis, rig = thesis_rig(), next(training_logs())[1].rig
    for one, other in (
        (thesis.lidars["lidar"], rig.lidars["lidar"]),
        (thesis.radars["radar"], rig.radars["rear_radar"]),
    ):
        assert one.points_per_s / one.rate_hz == other.points_per_s / other.rate_hz
    assert rig.cameras["front"].rate_hz == rig.radars["front_radar"].rate_hz == rig.lidars["lidar"].rate_hz / 2


def test_four_cameras_look_ahead_back_and_to_the_sides():
    for _, spec in training_logs():
        cameras = {name: (c.translation_m, c.yaw_pitch_roll_deg) for name, c in spec.rig.cameras.items()}
        assert cameras == {
            "front": ((2.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
            "rear": ((-2.0, 0.0, 1.2), (180.0, 0.0, 0.0)),
            "left": ((0.5, 0.8, 1.4), (60.0, 0.0, 0.0)),
            "right": ((0.5, -0.8, 1.6), (-60.0, 0.0, 0.0)),
        }
