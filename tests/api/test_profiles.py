"""Fitting of profiles: times that follow what frames hold are found again, and what was measured is kept exactly."""

from hypothesis import given, settings
from hypothesis import strategies as st

from fbench.api.profiles import fit_profile
from fbench.replay.engine.latency_profile import REST, FrameContent


def fit(times, contents):
    return fit_profile("mine", "log", 2, {"cpu": "A"}, times, contents)


def test_rates_are_found_again():
    """Detection: 1 ms + 50 ns a point; tracking: 2 ms + 100 us a box; 3 ms are in no stage; pixels never change."""
    contents = [FrameContent(1000 * i, (i * 7) % 5, 640 * 480) for i in range(1, 30)]
    detect = [1_000_000 + 50 * c.num_points for c in contents]
    track = [2_000_000 + 100_000 * c.num_boxes for c in contents]
    times = [{"detect": d, "track": t, "total": d + t + 3_000_000} for d, t in zip(detect, track, strict=True)]
    found = fit(times, contents)
    assert [model.stage for model in found.stages] == ["detect", "track", REST]
    rates = [(m.base_ns, m.ps_per_point, m.ps_per_box, m.ps_per_pixel) for m in found.stages]
    assert rates == [(1_000_000, 50_000, 0, 0), (2_000_000, 0, 100_000_000, 0), (3_000_000, 0, 0, 0)]
    assert {ns for row in found.residuals_ns for ns in row} == {0}
    assert found.stages[0].predict_ns(FrameContent(100_000, 0, 0)) == 6_000_000


def test_a_rate_is_never_negative():
    contents = [FrameContent(1000 * i, 0, 0) for i in range(10)]
    found = fit([{"detect": 10_000 - 900 * i, "total": 10_000} for i in range(10)], contents)
    assert found.stages[0].ps_per_point == 0
    assert found.stages[0].base_ns == 5950  # the mean


times_ns = st.integers(0, 10**9)
frames = st.tuples(st.integers(0, 10**6), st.integers(0, 99), st.integers(0, 10**7), times_ns, times_ns, st.booleans())


@settings(max_examples=30, deadline=None)
@given(st.lists(frames, min_size=5, max_size=20))
def test_what_was_measured_is_kept_to_the_nanosecond(given_frames):
    contents = [FrameContent(*frame[:3]) for frame in given_frames]
    times = [
        {**({"detect": d} if runs else {}), "track": t, "total": d // 2 + t} for *_, d, t, runs in given_frames
    ]  # in parallel: the whole is less than its stages
    found = fit(times, contents)
    for own, content, residuals in zip(times, contents, found.residuals_ns, strict=True):
        parts = {
            model.stage: model.predict_ns(content) + residual
            for model, residual in zip(found.stages, residuals, strict=True)
            if residual is not None
        }
        assert sum(parts.values()) == own["total"]
        assert {stage: ns for stage, ns in parts.items() if stage != REST} == {s: own[s] for s in own if s != "total"}
