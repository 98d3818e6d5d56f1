"""Logs under conditions: windows, scopes, order, instants, needs, and plug-ins that break their promise."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from tests.replay.engine.test_run import content, play
from tests.replay.fakes import MS, RIG, Echo, FakeLog, box, drive

import fbench.replay.conditions.steps as module
from fbench.replay.conditions.disturb import Disturbance, DisturbedReader
from fbench.replay.conditions.effects import Effects, describe
from fbench.replay.conditions.spec import parse_conditions
from fbench.replay.contracts.conditions import Part
from fbench.replay.contracts.errors import ConfigError, FbenchError, LogError, RunError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.street import PERIOD_NS, Street
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, RadarScan, Tick, Truth
from fbench.replay.data.rig import LogSpan, RigChange
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.read_ahead import open_ahead
from fbench.replay.runs.digest import digest


class Shift:
    """Moves all points ahead, and notes what it was given."""

    version, levels = 1, {"shift_m": (1.0, 2.0, 3.0, 4.0, 5.0)}
    kinds: tuple[str, ...] = ("lidar", "radar")

    def __init__(self, needs=()):
        self.sites, self.needs = [], needs

    def disturb(self, message, level, site):
        self.sites.append((message.stamp_ns, site))
        return (replace(message, xyz=message.xyz + np.float32([level["shift_m"], 0, 0])),)


def part(condition, strength="2", **more):
    level = {name: values[int(strength) - 1] for name, values in condition.levels.items()}
    return Part("mine", condition, strength, level, **more)


def span_of(log):
    times = [item.log_ns for item in log.messages() if not isinstance(item, RigChange)]
    return LogSpan(min(times), max(times), dict.fromkeys(log.rig.mounts, 100 * MS))


def disturb(log, *parts, seed=0, effects=None):
    reader = DisturbedReader(log, Disturbance(parts, seed, span_of(log)), effects or Effects())
    return list(reader.messages())


def xs(items, sensor="lidar"):
    return [float(m.xyz[0, 0]) for m in items if not isinstance(m, Tick) and m.sensor == sensor]


def test_windows_are_half_open_in_log_time_from_the_first_message():
    found = disturb(drive(6), part(Shift(), from_ns=200 * MS, to_ns=400 * MS))
    assert xs(found) == [10, 11, 12 + 2, 13 + 2, 14, 15]
    assert xs(disturb(drive(4), part(Shift(), from_ns=200 * MS))) == [10, 11, 14, 15]
    assert xs(disturb(drive(4), part(Shift(), to_ns=200 * MS))) == [12, 13, 12, 13]


def test_scopes():
    log = drive(3)
    for sensors, moved in (("", {"lidar", "radar"}), ("lidar", {"lidar"}), ("rad*", {"radar"})):
        found = disturb(log, part(Shift(), sensors=sensors))
        assert {m.sensor for m in found if m.xyz[0, 0] in (12, 13, 14) and xs(found, m.sensor)[0] == 12} == moved
    with pytest.raises(ConfigError, match="the log has no such sensor; it has: lidar, radar"):
        disturb(log, part(Shift(), sensors="camera"))
    with pytest.raises(ConfigError, match="no such sensor"):
        disturb(log, part(Shift(), sensors="lidar_top"))


def test_a_window_behind_the_log_is_refused():
    with pytest.raises(ConfigError, match=r"mine:2 \(0.6s-\): the window begins after the log, which lasts 0.500 s"):
        disturb(drive(6), part(Shift(), from_ns=600 * MS))


def test_parts_act_one_after_the_other():
    found = disturb(drive(2), part(Shift(), "1"), part(Shift(), "3", sensors="lidar"))
    assert xs(found) == [14, 15]
    assert xs(found, "radar") == [11, 12]


def test_weathers_of_one_scope_and_window_are_one(monkeypatch):
    seen = []

    def note(message, weather, site):
        seen.append(weather)
        return message

    monkeypatch.setattr(module, "disturb_by_weather", note)
    disturb(drive(1), *parse_conditions("fog:150m+rain:10mmh+night:3lux"))
    weather = seen[0]
    assert (len(seen), weather.visibility_m, weather.rain_mm_h, weather.lux) == (2, 150, 10, 3)
    seen.clear()
    disturb(drive(1), *parse_conditions("fog:150m+rain.lidar:10mmh"))
    assert sorted((weather.visibility_m, weather.rain_mm_h) for weather in seen) == [(150, 0), (150, 10)]
    seen.clear()
    disturb(drive(1), *parse_conditions("fog:150m+rain:10mmh@0s-"))
    assert len(seen) == 4  # another window: one after the other


class Late:
    """Delivers clouds late by their number, and radar scans never."""

    version, kinds, levels, changes_times = 1, ("lidar", "radar"), {"late_ms": (50, 150, 250, 350, 450)}, True

    def disturb(self, message, level, site):
        if isinstance(message, RadarScan):
            return ()
        return (replace(message, log_ns=message.log_ns + level["late_ms"] * MS), message)


def test_messages_come_in_the_order_in_which_they_are_delivered():
    found = disturb(drive(5), part(Late()))
    assert [item.log_ns for item in found] == sorted(item.log_ns for item in found)
    stamps = [m.stamp_ns // MS for m in found if not isinstance(m, Tick)]
    assert stamps == [0, 100, 0, 200, 100, 300, 200, 400, 300, 400]
    ticks = [(t.sensor, t.stamp_ns // MS, t.log_ns // MS) for t in found if isinstance(t, Tick)]
    assert ticks == [(name, 100 * i, 100 * i) for i in range(5) for name in ("lidar", "radar")]


ON_THE_REFERENCE = (
    "dropout.lidar:3", "loss.lidar:5", "delay.lidar:5", "offset.lidar:5", "reorder.lidar:2", "clock_jump.lidar:5",
    "duplicate.lidar:5", "drift.lidar:5", "burst_loss:5",
)  # fmt: skip


@pytest.mark.parametrize("text", ON_THE_REFERENCE)
def test_frames_keep_number_and_instants_whatever_becomes_of_the_reference(tmp_path, text):
    log = drive(30)
    clear = play(log, tmp_path / "clear")
    run = play(log, tmp_path / "run", disturbance=Disturbance(parse_conditions(text), 0, span_of(log)))
    assert [f.stamp_ns for f in run.frames] == [f.stamp_ns for f in clear.frames]
    assert {f.segment for f in run.frames} == {0}
    assert run.manifest.complete
    assert run.json("faults.json")["lost"] == 0
    assert run.manifest.effects["lidar"]["changed"] > 0


def test_a_sensor_that_drops_out_is_missing_and_nothing_else_changes(tmp_path):
    log = drive(30)
    disturbance = Disturbance(parse_conditions("dropout.lidar:5@1s-2s"), 0, span_of(log))
    run = play(log, tmp_path / "run", disturbance=disturbance)
    assert [f.index for f in run.frames if "lidar" in f.missing] == list(range(10, 20))
    assert run.manifest.effects == {
        "lidar": {
            "messages": 30, "dropped": 10, "added": 0, "changed": 10, "late": 0, "restamped": 0,
            "points_before": 40, "points_after": 40, "points_moved": 0, "moved_m": 0.0, "points_revalued": 0,
        }
    }  # fmt: skip


def test_a_clock_set_wrong_by_a_minute_is_a_result(tmp_path):
    """Clocks are compared as they were recorded, so that one which a condition sets wrong isn't refused (TIM008)."""

    class Wrong:
        version, kinds, levels, changes_times = 1, ("radar",), {"ahead_s": (1, 60, 61, 3600, 10**6)}, True

        def disturb(self, message, level, site):
            return (replace(message, stamp_ns=message.stamp_ns + level["ahead_s"] * 1000 * MS),)

    log = drive(20)
    run = play(log, tmp_path / "run", disturbance=Disturbance([part(Wrong(), "5")], 0, span_of(log)))
    assert all("radar" in f.missing for f in run.frames)
    late = [replace(m, stamp_ns=m.stamp_ns + 10**15) if m.sensor == "radar" else m for m in log.items]
    with pytest.raises(LogError, match="its clock differs"):  # as recorded, it still is
        play(replace(log, items=late), tmp_path / "refused", disturbance=Disturbance([part(Wrong())], 0, span_of(log)))


@pytest.mark.parametrize(
    "text", ["delay.lidar:5+loss:4", "reorder:3", "jitter:5+duplicate:5", "burst_loss:4+offset.radar:4"]
)
def test_part_of_a_log_gives_the_frames_of_the_whole(tmp_path, text):
    log = drive(40)
    disturbance = Disturbance(parse_conditions(text), 3, span_of(log))
    whole = play(log, tmp_path / "whole", disturbance=disturbance).frames
    excerpt = play(log, tmp_path / "part", disturbance=disturbance, excerpt=Excerpt(20, 30)).frames
    names = [(f.index, f.stamp_ns, sorted(f.missing)) for f in excerpt]
    assert names == [(f.index, f.stamp_ns, sorted(f.missing)) for f in whole[20:30]]


@pytest.mark.parametrize("text", ["delay.lidar:3", "loss:4+jitter:5", "dropout:3"])
def test_reading_ahead_changes_nothing(tmp_path, text):
    log, runs = drive(30), []
    for name, limit in (("none", 0), ("one", 1), ("all", None)):
        with open_ahead(lambda faults: log, FaultLog(), limit) as reader:
            play(reader, tmp_path / name, disturbance=Disturbance(parse_conditions(text), 0, span_of(log)))
        runs.append(content(tmp_path / name))
    assert runs[0] == runs[1] == runs[2]


def test_without_conditions_a_run_is_the_same_byte_for_byte(tmp_path):
    log = drive(10)
    play(log, tmp_path / "clear")
    play(log, tmp_path / "zero", disturbance=Disturbance(parse_conditions("fog:0+clear"), 5, span_of(log)))
    assert content(tmp_path / "clear") == content(tmp_path / "zero")


def test_the_seed_and_the_strength_decide_what_is_drawn():
    def lost(text, seed):
        found = disturb(drive(60), *parse_conditions(text), seed=seed)
        return [m.stamp_ns for m in found if not isinstance(m, Tick) and m.sensor == "lidar"]

    assert lost("loss:4", 0) == lost("loss:4", 0)
    assert lost("loss:4", 0) != lost("loss:4", 1)
    assert lost("loss:4", 0) != lost("loss:40%", 0)


def test_what_is_known_at_the_place_of_a_message():
    shift, log = Shift(("truth",)), drive(12)
    log.labels = [Truth(300 * MS + 40 * MS, 0, box(1.0)), Truth(600 * MS + 51 * MS, 0, box(2.0))]
    disturb(log, part(shift, sensors="lidar", from_ns=100 * MS, to_ns=10**9))
    sites = dict(shift.sites)
    assert [m.stamp_ns // MS for m in sites[900 * MS].history] == [100 * i for i in range(1, 9)]
    assert float(sites[900 * MS].history[-1].xyz[0, 0]) == 18.0  # as recorded
    assert (sites[300 * MS].first_ns, sites[300 * MS].last_ns) == (100 * MS, 10**9)  # the window's
    known = {stamp // MS: float(site.truth.center_m[0, 0]) for stamp, site in shift.sites if site.truth is not None}
    assert known == {300: 1.0, 700: 2.0}


class Bright:
    """Adds 1 to every pixel, and notes where."""

    version, kinds, levels = 1, ("camera",), {"gray_levels": (1, 2, 3, 4, 5)}

    def __init__(self):
        self.sites = []

    def disturb(self, message, level, site):
        assert message.encoding == "bgr8"
        self.sites.append(site)
        pixels = np.frombuffer(message.data, np.uint8)
        return (replace(message, data=(pixels + np.uint8(level["gray_levels"])).tobytes()),)


def test_images_come_raw_and_with_the_nearest_cloud():
    bright, effects, log = Bright(), Effects(), Street(3)
    found = disturb(log, part(bright), effects=effects)
    images = [m for m in found if isinstance(m, Image)]
    assert len(images) == 3
    assert [site.cloud.stamp_ns for site in bright.sites] == [m.stamp_ns for m in images]
    assert effects.rows()["camera"]["gray_levels"] == 3 * 2.0


def test_images_that_cant_be_decoded_stay_as_they_are():
    bad = Image("camera", 5, 5, encode_jpeg(np.zeros((120, 160, 3), np.uint8))[:30], "jpeg", (160, 120))
    log = FakeLog([bad], rig=Street().rig)
    assert disturb(log, part(Bright())) == [bad]


def test_history_and_clouds_end_where_the_rig_changes():
    log, shift, bright = Street(4), Shift(), Bright()
    items = list(log.messages())
    moved = replace(log.rig.mounts["lidar"], translation_m=np.ones(3))
    change = RigChange(items[6].log_ns, replace(log.rig, mounts={**log.rig.mounts, "lidar": moved}), ("lidar",))

    @dataclass
    class Changing(FakeLog):
        def messages(self):
            yield from [*items[:6], change, *items[7:]]  # without the cloud just behind the change

    disturb(Changing(items, rig=log.rig), part(shift), part(bright))
    assert [len(site.history) for stamp, site in shift.sites if site.sensor == "lidar"] == [0, 1, 0]
    assert shift.sites[-1][1].rig is change.rig
    assert [site.cloud is None for site in bright.sites] == [False, False, True, False]


def test_an_image_gets_the_cloud_that_comes_with_it_also_where_the_rig_changes():
    """As in KITTI's single frames, each with a calibration of its own."""
    log, bright = Street(2), Bright()
    items = sorted(log.messages(), key=lambda m: (m.log_ns, m.sensor))  # the camera's first
    change = RigChange(items[3].log_ns, log.rig, ("lidar",))

    @dataclass
    class Changing(FakeLog):
        def messages(self):
            yield from [*items[:3], change, *items[3:]]

    disturb(Changing(items, rig=log.rig), part(bright))
    assert [site.cloud.stamp_ns for site in bright.sites] == [items[0].stamp_ns, items[3].stamp_ns]


def test_what_a_log_lacks_is_an_error():
    with pytest.raises(LogError, match=r"condition mine\.lidar:2 can't act: 'lidar' has no ring") as found:
        disturb(drive(2), part(Shift(("ring",)), sensors="lidar"))
    assert found.value.code == "COR002"
    with pytest.raises(LogError, match="needs 3D truth in body coordinates") as found:
        disturb(FakeLog(drive(2).items), *parse_conditions("object.moved"))
    assert found.value.code == "COR002"
    bare = replace(Street().rig, cameras={})
    with pytest.raises(LogError, match="intrinsic:3 can't act: camera has no calibration") as found:
        disturb(FakeLog(list(Street(1).messages()), rig=bare), *parse_conditions("intrinsic"))
    assert found.value.code == "COR002"
    assert found.value.exit_code == 3


def returns(make):
    class Mine(Shift):
        def disturb(self, message, level, site):
            return make(message, level, site)

    return Mine()


def write_into(message, level, site):
    message.xyz[0, 0] = 5


def write_by_force(message, level, site):
    message.xyz.setflags(write=True)
    return (write_into(message, level, site), message)[1:]


def set_by_force(message, level, site):
    object.__setattr__(message, "stamp_ns", 5)
    return [message]


def change_level(message, level, site):
    level["shift_m"] = 7


def fail(message, level, site):
    raise ValueError("two\nlines")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (fail, "condition 'mine' failed: ValueError: two (test_disturb.py:"),
        (write_into, "condition 'mine' failed: ValueError: assignment destination is read-only"),
        (write_by_force, "condition 'mine' changed 'xyz' of the message that it was given"),
        (set_by_force, "condition 'mine' changed 'stamp_ns' of the message that it was given"),
        (change_level, "condition 'mine' failed: TypeError: 'mappingproxy'"),
        (lambda m, level, site: m, "condition 'mine' failed: TypeError"),
        (lambda m, level, site: None, "condition 'mine' failed: TypeError"),
        (lambda m, level, site: ["x"], "condition 'mine' gave str for PointCloud"),
        (lambda m, level, site: [Tick("lidar", 0, 0)], "condition 'mine' gave Tick for PointCloud"),
        (lambda m, level, site: [replace(m, sensor="radar")], "gave a message of 'radar' for one of 'lidar'"),
        (lambda m, level, site: [replace(m, log_ns=m.log_ns - 5 * MS)], "5 ms before it was recorded"),
        (lambda m, level, site: [], "drops, repeats, delays or restamps messages, but doesn't say changes_times"),
        (lambda m, level, site: [m, m], "drops, repeats, delays or restamps"),
        (lambda m, level, site: [replace(m, stamp_ns=m.stamp_ns + 1)], "drops, repeats, delays or restamps"),
        (lambda m, level, site: [replace(m, frame_number=3)], "drops, repeats, delays or restamps"),
        (lambda m, level, site: [replace(m, xyz=m.xyz[:, :2])], "PointCloud.xyz: expected float32"),
    ],
)  # fmt: skip
def test_conditions_that_break_their_promise_end_the_replay_in_one_line(make, words):
    log = drive(2)
    before = digest(log.items)
    with pytest.raises(FbenchError) as found:
        disturb(log, part(returns(make), sensors="lidar"))
    assert words in str(found.value)
    assert "\n" not in str(found.value)
    assert found.value.exit_code == 3
    assert digest(log.items) == before


def test_a_failure_on_the_rig_is_fatal_also_within_the_log(tmp_path):
    class Once:
        version, kinds, levels = 1, ("lidar",), {"x": (1, 2, 3, 4, 5)}

        def __init__(self):
            self.num = 0

        def disturb(self, message, level, site):
            return (message,)

        def disturb_rig(self, rig, level, site):
            self.num += 1
            if self.num == 2:
                raise ValueError("no more")
            return rig

    log = drive(6)
    change = RigChange(250 * MS, replace(RIG), ("lidar",))

    @dataclass
    class Changing(FakeLog):
        def messages(self):
            yield from sorted([*self.items, change], key=lambda m: m.log_ns)

    changing = Changing(log.items, log.labels)
    with pytest.raises(RunError, match="condition 'mine' failed: ValueError: no more"):
        play(changing, tmp_path / "run", disturbance=Disturbance([part(Once())], 0, span_of(log)))
    assert not (tmp_path / "run").exists()
    with pytest.raises(ConfigError, match="a wrong calibration holds for the whole log"):
        play(log, tmp_path / "run", disturbance=Disturbance([part(Once(), to_ns=5)], 0, span_of(log)))


def test_messages_with_numbers_join_their_frame_whatever_their_stamps(tmp_path):
    log = Street(20)
    disturbance = Disturbance(parse_conditions("offset.radar:5+jitter:5+duplicate:5"), 0, log.span)
    run = play(log, tmp_path / "run", disturbance=disturbance, sync=SyncParams(timeout_ns=PERIOD_NS))
    assert run.manifest.num_frames == 20
    assert all(not f.missing for f in run.frames)


def test_the_pipeline_gets_the_wrong_calibration_and_results_are_judged_by_the_right_one(tmp_path):
    log, pipeline = drive(5), Echo()
    run = play(
        log, tmp_path / "run", pipeline, disturbance=Disturbance(parse_conditions("extrinsic.lidar:5"), 0, span_of(log))
    )
    assert np.linalg.norm(pipeline.rig.mounts["lidar"].translation_m) == pytest.approx(0.5)
    assert pipeline.rig.mounts["radar"].equals(RIG.mounts["radar"])
    assert run.manifest.mounts["lidar"].translation_m == [0, 0, 0]
    effect = run.manifest.effects["lidar"]
    assert (effect["mount_deg"], effect["mount_m"], effect["changed"]) == (pytest.approx(3, rel=1e-5), 0.5, 0)


def test_a_sensor_that_the_pipeline_doesnt_get_may_be_disturbed(tmp_path):
    log = drive(5)
    run = play(
        log,
        tmp_path / "run",
        sensors=["lidar"],
        disturbance=Disturbance(parse_conditions("extrinsic.radar:5"), 0, span_of(log)),
    )
    assert "mount_deg" not in run.manifest.effects["radar"]


class OnlyLidar(Echo):
    def used_sensors(self):
        return ["lidar"]


def test_what_a_pipeline_does_not_use_stays_as_recorded_where_nobody_looks_at_it(tmp_path):
    log = drive(5)

    def run(name, pipeline, num_media, **plan):
        shift = Shift()
        disturbance = Disturbance((part(shift),), 0, span_of(log))
        result = play(log, tmp_path / name, pipeline, num_media=num_media, disturbance=disturbance, **plan)
        return result, [site.sensor for _, site in shift.sites].count("radar")

    spared, num = run("spared", OnlyLidar(), 0)
    assert (num, spared.manifest.effects["radar"]) == (0, {"messages": 5, "unused": 5})
    assert describe(spared.manifest.effects["radar"]) == "as recorded, since the pipeline doesn't use it"
    for name, pipeline, num_media in (("shown", OnlyLidar(), 8), ("silent", Echo(), 0)):
        whole, num = run(name, pipeline, num_media)
        assert (num, whole.manifest.effects["radar"]["changed"]) == (5, 5)
        assert whole.manifest.digest == spared.manifest.digest
        assert whole.manifest.effects["lidar"] == spared.manifest.effects["lidar"]
    assert run("chosen", Echo(), 8, sensors=["lidar"])[1] == 0  # the pipeline doesn't get the radar


def test_times_of_what_is_not_used_change_all_the_same(tmp_path):
    log = drive(20)
    runs = [
        play(log, tmp_path / type(pipeline).__name__, pipeline, num_media=0,
             disturbance=Disturbance(parse_conditions("loss.radar:5+radar.shift:2"), 0, span_of(log)))
        for pipeline in (Echo(), OnlyLidar())
    ]  # fmt: skip
    assert runs[0].manifest.effects == runs[1].manifest.effects
    assert runs[0].manifest.digest == runs[1].manifest.digest
    assert any(frame.missing for frame in runs[1].frames)


def test_what_a_message_lacks_is_an_error_also_where_it_is_not_used(tmp_path):
    with pytest.raises(LogError, match=r"condition mine.radar:2 can't act: 'radar' has no rcs"):
        play(
            drive(3), tmp_path / "run", OnlyLidar(), num_media=0,
            disturbance=Disturbance((part(Shift(["rcs"]), sensors="radar"),), 0, span_of(drive(3))),
        )  # fmt: skip
