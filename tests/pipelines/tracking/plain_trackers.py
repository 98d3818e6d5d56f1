"""Both trackers written down plainly: one object a track, whole matrices, loops over pairs, all pairs assigned at once.

They know what decides which track goes where, and where it is shown: no smoothing, no mean scores, no poses.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from fbench.pipelines.tracking.association import footprint_iou, giou_2d, giou_3d
from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams
from fbench.replay.data.boxes import LABELS, VEHICLES, Boxes2D, Boxes3D


@dataclass
class Track:
    number: int
    mean: np.ndarray
    cov: np.ndarray
    label: str
    stamp_ns: int
    hits: int = 1
    missed: int = 0
    votes: dict[str, float] = field(default_factory=dict)
    carried: dict[str, Any] = field(default_factory=dict)

    def predict(self, dt: float, drift_std: np.ndarray) -> None:
        num = len(drift_std)
        step = np.eye(2 * num)
        step[:num, num:] = dt * np.eye(num)
        q = np.diag(drift_std**2)
        noise = np.block([[q * dt**3 / 3, q * dt**2 / 2], [q * dt**2 / 2, q * dt]])
        self.mean, self.cov = step @ self.mean, step @ self.cov @ step.T + noise

    def update(self, z: np.ndarray, std: np.ndarray) -> None:
        look = np.eye(len(z), 2 * len(z))
        gain = self.cov @ look.T @ np.linalg.inv(look @ self.cov @ look.T + np.diag(std**2))
        self.mean = self.mean + gain @ (z - look @ self.mean)
        self.cov = (np.eye(2 * len(z)) - gain @ look) @ self.cov

    def vote(self, label: str, score: float) -> None:
        if label in LABELS and label != "other":
            self.votes[label] = self.votes.get(label, 0.0) + (score if score >= 0 else 1e-3)

    def best_label(self) -> str:
        best = max(self.votes.values(), default=0.0)
        return next((name for name in LABELS if best and self.votes.get(name, 0.0) == best), "other")


class PlainTracker:
    """What both share; those below say what is measured and how alike things are."""

    read: Any
    std: Any
    rate_std: Any
    advance: Any
    alike: Any
    carried: Any
    place: Any

    def __init__(self, params) -> None:
        self.params = params
        self.tracks: list[Track] = []
        self.next = 1
        self.steps = 0
        self.stamp_ns = 0

    def step(self, boxes, stamp_ns):
        p, found = self.params, self.read(boxes)
        for track in self.tracks:
            self.advance(track, (stamp_ns - self.stamp_ns) * 1e-9)
        weak = [one["score"] < p.weak_score for one in found]
        self.stamp_ns = stamp_ns
        taken, pairs = set(), []
        for turn in (False, True):
            alike = np.zeros((len(self.tracks), len(found)))
            for i, track in enumerate(self.tracks):
                for j, one in enumerate(found):
                    free = not any(i == row for row, _ in pairs) and weak[j] == turn
                    alike[i, j] = self.alike(track, one) if free and not rivals(track, one) else 0.0
            rows, columns = linear_sum_assignment(alike, maximize=True)
            pairs += [(r, c) for r, c in zip(rows.tolist(), columns.tolist(), strict=True) if alike[r, c] > 0]
        later = self.pair_within_reach(pairs, found, weak)
        for i, track in enumerate(self.tracks):
            track.missed += 1
            for j in [j for row, j in pairs + later if row == i]:
                is_sure = (i, j) in pairs or track.hits >= p.min_hits
                taken |= {j} if is_sure else set()
                self.measure(track, found[j], is_sure)
        self.tracks = [t for t in self.tracks if not t.missed or (t.hits >= p.min_hits and t.missed <= p.max_missed)]
        for j, one in enumerate(found):
            if j not in taken and not weak[j]:
                self.tracks.append(self.begin(one))
        self.steps += 1
        return self.shown()

    def pair_within_reach(self, pairs, found, weak):
        """Pairs of what `pairs` left."""
        near = np.zeros((len(self.tracks), len(found)))
        for i, track in enumerate(self.tracks):
            for j, one in enumerate(found):
                is_left = not any(i == row or j == column for row, column in pairs)
                near[i, j] = self.near(track, one) if is_left and not weak[j] and not rivals(track, one) else 0.0
        rows, columns = linear_sum_assignment(near, maximize=True)
        return [(r, c) for r, c in zip(rows.tolist(), columns.tolist(), strict=True) if near[r, c] > 0]

    def near(self, track, one):
        return 0.0

    def measure(self, track, one, is_sure):
        track.update(one["z"], self.std(one["z"]))
        track.hits, track.missed, track.stamp_ns = track.hits + is_sure, 0, self.stamp_ns
        track.label, track.carried = one["label"], self.carried(track, one)
        track.vote(one["label"], one["score"])

    def begin(self, one):
        z, num = one["z"], len(one["z"])
        cov = np.diag(np.concatenate([self.std(z), self.rate_std(z)]) ** 2)
        track = Track(self.next, np.concatenate([z, np.zeros(num)]), cov, one["label"], self.stamp_ns)
        track.carried = one
        track.vote(one["label"], one["score"])
        self.next += 1
        return track

    def shown(self):
        """Id, label, score, whether it is predicted, and place."""
        p = self.params
        return [
            (t.number, t.best_label(), t.carried["score"], t.stamp_ns < self.stamp_ns, self.place(t))
            for t in self.tracks
            if t.hits >= min(p.min_hits, self.steps)
            and t.missed <= p.max_missed_shown
            and t.missed * p.hits_per_missed <= t.hits
            and (self.stamp_ns - t.stamp_ns) * 1e-9 <= p.max_coast_s
        ]

    def mahalanobis(self, track, one):
        num = len(one["z"])
        apart = one["z"] - track.mean[:num]
        spread = track.cov[:num, :num] + np.diag(self.std(one["z"]) ** 2)
        return max(0.0, 1 - np.sqrt(apart @ np.linalg.inv(spread) @ apart) / self.params.max_mahalanobis)


class Plain3D(PlainTracker):
    params: Tracker3DParams

    def read(self, boxes: Boxes3D):
        return [
            {"z": boxes.center_m[i], "size": boxes.size_lwh_m[i], "yaw": boxes.yaw_rad[i],
             "label": str(boxes.label[i]), "score": float(boxes.score[i])}
            for i in range(len(boxes))
        ]  # fmt: skip

    def std(self, z):
        return np.full(3, self.params.measured_std_m)

    def rate_std(self, z):
        return np.full(3, self.params.rate_std_mps)

    def advance(self, track, dt):
        track.predict(dt, np.full(3, self.params.drift_std_mps))

    def carried(self, track, one):
        return one

    def place(self, track):
        return np.concatenate([track.mean, track.carried["size"], [track.carried["yaw"]]])

    def growth(self, track):
        return max(self.params.gate_mps, self.params.new_gate_mps) if track.hits == 1 else self.params.gate_mps

    def near(self, track, one):
        if self.params.association != "giou":
            return 0.0
        is_slow = track.best_label() == "pedestrian"
        speed = min(self.growth(track), self.params.pedestrian_gate_mps) if is_slow else self.growth(track)
        reach = speed * (self.stamp_ns - track.stamp_ns) * 1e-9
        return max(0.0, 1 - np.hypot(*(track.mean[:2] - one["z"][:2])) / reach)

    def alike(self, track, one):
        p = self.params
        if p.association == "distance":
            gate = p.gate_m + self.growth(track) * (self.stamp_ns - track.stamp_ns) * 1e-9
            return max(0.0, 1 - np.hypot(*(track.mean[:2] - one["z"][:2])) / gate)
        if p.association == "mahalanobis":
            return self.mahalanobis(track, one)
        a = np.concatenate([track.mean[:3], track.carried["size"], [track.carried["yaw"]]])[None]
        b = np.concatenate([one["z"], one["size"], [one["yaw"]]])[None]
        if p.association == "giou":
            giou = giou_3d(a, b)[0, 0]
            return (giou + 1) / 2 if giou >= p.min_giou else 0.0
        iou = footprint_iou(a, b)[0, 0]
        return iou if iou >= p.min_iou else 0.0


class Plain2D(PlainTracker):
    params: Tracker2DParams

    def read(self, boxes: Boxes2D):
        return [
            {"z": measured(boxes.xyxy_px[i]), "box": boxes.xyxy_px[i], "camera": str(boxes.camera[i]),
             "label": str(boxes.label[i]), "score": float(boxes.score[i]), "distance": boxes.distance_m[i],
             "range_rate": boxes.range_rate_mps[i]}
            for i in range(len(boxes))
        ]  # fmt: skip

    def std(self, z):
        return self.params.measured_std * unit(z)

    def rate_std(self, z):
        return self.params.rate_std * unit(z)

    def advance(self, track, dt):
        before = track.mean
        track.predict(dt, self.params.drift_std * unit(track.mean))
        for k in (2, 3):
            if track.mean[k] < 1e-3:
                track.mean[k], track.mean[k + 4] = max(before[k], 1e-3), 0.0
        rate = track.carried["range_rate"]
        distance = track.carried["distance"] + (0.0 if np.isnan(rate) else rate) * dt
        track.carried = track.carried | {"distance": distance}

    def carried(self, track, one):
        kept = {name: track.carried[name] for name in ("distance", "range_rate") if np.isnan(one[name])}
        return one | kept

    def place(self, track):
        return np.array([*corners(track.mean), track.carried["distance"], track.carried["range_rate"]])

    def alike(self, track, one):
        p = self.params
        if track.carried["camera"] != one["camera"]:
            return 0.0
        if p.association == "mahalanobis":
            return self.mahalanobis(track, one)
        a = corners(track.mean)
        if p.association == "giou":
            giou = giou_2d(a[None], one["box"][None])[0, 0]
            return (giou + 1) / 2 if giou >= p.min_giou else 0.0
        iou = overlap(a, one["box"])
        return iou if iou >= p.min_iou else 0.0


def rivals(track, one):
    kinds = ["vehicle" if label in VEHICLES else label for label in (track.label, one["label"])]
    return "other" not in kinds and kinds[0] != kinds[1]


def measured(box):
    width, height = np.maximum(box[2:] - box[:2], 1e-3)
    return np.array([*(box[:2] + box[2:]) / 2, width * height, width / height])


def unit(z):
    return np.array([np.sqrt(z[2]), np.sqrt(z[2]), z[2], z[3]])


def corners(z):
    half = np.array([np.sqrt(z[2] * z[3]), np.sqrt(z[2] / z[3])]) / 2
    return np.concatenate([z[:2] - half, z[:2] + half])


def overlap(a, b):
    common = np.prod(np.maximum(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0))
    union = np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - common
    return common / union if union > 0 else 0.0
