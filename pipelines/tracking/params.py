"""Parameters of the trackers."""

from dataclasses import dataclass
from typing import Literal

from fbench.replay.contracts.params import LIMIT, CheckedParams, in_range

MIN_STD = 1e-6


@dataclass(frozen=True)
class TrackerParams(CheckedParams, prefix="tracking"):
    """What trackers in 3D and in images share."""

    min_giou: float = in_range(-0.2, -1, 1)
    """With `giou`: detections whose generalized overlap with a track's prediction is less don't belong to it; from -1
    (infinitely far) to 1 (equal).
    """
    max_mahalanobis: float = in_range(4.0, MIN_STD)  # With `mahalanobis`: greatest distance in standard deviations.
    weak_score: float = in_range(-LIMIT, -LIMIT)
    """Detections with a lower score come last: they go to tracks that no other measured, and begin none."""
    max_missed: int = in_range(2, 0)
    """A track ends when more steps than this in a row didn't measure it, or one before it had `min_hits`."""
    max_missed_shown: int = in_range(2, 0)
    """A track that more steps than this in a row didn't measure isn't shown, but goes on."""
    hits_per_missed: int = in_range(0, 0)
    """So many measurements a track takes for each step in a row in which it is shown though nothing measured it;
    0: any number will do, as long as `max_missed_shown` and `max_coast_s` allow it."""
    max_coast_s: float = in_range(0.5, 0)
    """A track that nothing measured for longer than this [s] is not shown, since its prediction is too uncertain."""
    min_hits: int = in_range(2, 0)
    """Measurements before a track is shown; in the first steps after a reset fewer are enough."""
    score: Literal["last", "mean"] = "last"  # Score of a track: that of its last detection, or the mean of all so far.
    predicted_share: float = in_range(1.0, 0, 1)  # Share of that score which a track has while nothing measures it.
    noise: Literal["acceleration", "identity"] = "acceleration"
    """Covariances of the filter. `acceleration`: measured, rate and drift standard deviations as below, and noise that
    grows with time. `identity`: scaled identities, as the thesis prints them: R, P and in each step Q, in the units of
    the state, whatever they are (m, m/s; px, px^2, 1).
    """
    identity_r: float = in_range(1.0, MIN_STD)  # With `identity`: variance of each measured component.
    identity_p: float = in_range(10.0, MIN_STD)  # With `identity`: first variance of each measured component.
    identity_rate_p: float = in_range(1000.0, MIN_STD)  # With `identity`: first variance of each rate, a large one.
    identity_q: float = in_range(0.1, 0)  # With `identity`: what each step adds to all variances.


@dataclass(frozen=True)
class Tracker3DParams(TrackerParams):
    """Parameters of the 3D tracker."""

    association: Literal["distance", "iou", "giou", "mahalanobis"] = "distance"
    """`distance`: nearest centers on the ground within a gate; `iou`: overlap seen from above; `giou`: generalized
    overlap in space, which also separates near from far where boxes don't overlap; `mahalanobis`: nearest centers in
    standard deviations of the filter.
    """
    gate_m: float = in_range(3.0, MIN_STD)
    """Greatest distance of a detection from a track's prediction [m], plus `gate_mps` times the time without one."""
    gate_mps: float = in_range(8.0, 0)
    """By how much the gate grows [m] for each second since a track was measured. With `giou`: how far a detection that
    nothing overlaps may be from a prediction [m] for each such second, and still belong to it."""
    new_gate_mps: float = in_range(20.0, 0)
    """The same for a track that was measured once and without a velocity, which may be any; at least `gate_mps`."""
    pedestrian_gate_mps: float = in_range(3.0, 0)  # With `giou`: both are at most this for pedestrians, who are slow.
    min_iou: float = in_range(0.05, 0, 1)
    """With `iou`: detections that overlap a track's prediction less than this don't belong to it."""
    measured_std_m: float = in_range(0.3, MIN_STD)  # Standard deviation of a measured center [m].
    rate_std_mps: float = in_range(10.0, 0)  # Standard deviation of a new track's velocity [m/s].
    drift_std_mps: float = in_range(5.0, 0)  # Change of velocity within one second, standard deviation [m/s].
    size_share: float = in_range(1.0, 0, 1)
    """Least share of a new measurement in a track's size: 1 takes the size measured last, 0 the mean of all."""
    yaw_share: float = in_range(1.0, 0, 1)
    """The same of its heading. Below 1, headings turned by pi count as measured the right way round."""
    ego_motion: bool = True  # Follow objects in world coordinates where poses are known; else in those of the body.


def steady_tracking() -> Tracker3DParams:
    """Return parameters for what fbench's own 3D pipelines detect: places are half a meter off now and then, road users
    change their speed slowly, and what was measured often is still there after up to five steps without a measurement.
    """
    return Tracker3DParams(
        max_missed=5, max_missed_shown=5, hits_per_missed=3, max_coast_s=0.55, measured_std_m=0.5, drift_std_mps=2.0,
    )  # fmt: skip


@dataclass(frozen=True)
class Tracker2DParams(TrackerParams):
    """Parameters of the 2D tracker. Noise is relative to a box's size: the side of a square of its area."""

    association: Literal["iou", "giou", "mahalanobis"] = "iou"
    """`iou`: overlap; `giou`: generalized overlap, which also separates near from far where boxes don't overlap;
    `mahalanobis`: nearest in standard deviations of the filter.
    """
    min_iou: float = in_range(0.1, 0, 1)
    """With `iou`: detections that overlap a track's prediction less than this don't belong to it."""
    max_missed_shown: int = in_range(0, 0)
    """A track that more steps than this in a row didn't measure isn't shown, but goes on: predictions in the image
    seldom overlap enough with what they show, and most objects that are missed have left the view.
    """
    measured_std: float = in_range(0.02, MIN_STD)
    """Standard deviation of a measured position, as a share of the box's size."""
    rate_std: float = in_range(5.0, 0)  # Standard deviation of a new track's rate of change, in box sizes a second.
    drift_std: float = in_range(5.0, 0)
    """Change of the rates within one second, standard deviation in box sizes a second."""
