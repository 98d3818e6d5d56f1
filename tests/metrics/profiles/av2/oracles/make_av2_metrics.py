"""Freeze what av2-api makes of the random logs, as `av2_metrics.json`.

Made with av2 0.3.6 and trackeval 1.3.0 (numpy 2.4.6, pandas 3.0.6, polars 2.1.0, scipy 1.17.1). Run it from the root of
the repository, in an environment of its own, a folder `ENV`, since av2 needs torch and more (`--no-deps` and what its
evaluation imports do). The numbers are written into `FOLDER`:

    python -m venv ENV && ENV/bin/pip install --no-deps av2==0.3.6 trackeval==1.3.0
    ENV/bin/pip install numpy==2.4.6 pandas polars pyarrow scipy tqdm click joblib numba opencv-python-headless
        rich universal_pathlib pyproj av matplotlib packaging tabulate
    PYTHONPATH=. ENV/bin/python -m tests.metrics.profiles.av2.oracles.make_av2_metrics FOLDER

No dataset is needed: the evaluations get the boxes directly, in the ego's coordinates, with the ego at the city's
origin. av2-api rounds its metrics to 3 digits; the script takes them before that.
"""

import contextlib
import io
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import av2.evaluation.detection.eval as detection  # type: ignore[import-not-found]
import numpy as np
import pandas as pd
from av2.evaluation.detection.utils import DetectionCfg  # type: ignore[import-not-found]
from av2.evaluation.scenario_mining import eval as mining  # type: ignore[import-not-found]
from av2.evaluation.tracking import eval as tracking  # type: ignore[import-not-found]
from av2.evaluation.tracking import utils  # type: ignore[import-not-found]
from tests.metrics.profiles.av2.oracles.av2_logs import PLANS, Log, Row, logs_of

KEYS = {
    "HOTA": ("HOTA", "DetA", "AssA", "LocA"),
    "CLEAR": ("MOTA", "MOTP", "CLR_Re", "CLR_Pr", "CLR_TP", "CLR_FP", "CLR_FN", "IDSW", "Frag", "MT", "ML"),
}


def table(logs: list[Log], side: str) -> pd.DataFrame:
    """Boxes as av2-api's detection evaluation reads them."""
    rows = []
    for log in logs:
        for row in getattr(log, side):
            half = row["yaw"] / 2
            rows.append(
                {
                    "log_id": log.name, "timestamp_ns": row["step"], "category": row["name"].upper(),
                    **dict(zip(("tx_m", "ty_m", "tz_m"), row["xyz"], strict=True)),
                    **dict(zip(("length_m", "width_m", "height_m"), row["lwh"], strict=True)),
                    "qw": np.cos(half), "qx": 0.0, "qy": 0.0, "qz": np.sin(half),
                    "num_interior_pts": row["points"], "score": row["score"],
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def detect(logs: list[Log]) -> dict[str, Any]:
    """Metrics by class; `AVERAGE_METRICS` is the mean over them."""
    cfg = DetectionCfg(eval_only_roi_instances=False)
    detection.NUM_DECIMALS = 15
    results, _, metrics = detection.evaluate(table(logs, "results"), table(logs, "truth"), cfg, n_jobs=1)
    hits: dict[str, Any] = {
        name: [int(own[m].sum()) for m in cfg.affinity_thresholds_m] for name, own in results.groupby("category")
    }
    used = ["AVERAGE_METRICS", *sorted({row["name"].upper() for log in logs for row in (*log.truth, *log.results)})]
    return {"metrics": metrics.loc[used].to_dict("index"), "hits": hits}


def frames(logs: list[Log], side: str) -> dict[str, list[dict[str, Any]]]:
    """Boxes as av2-api's tracking evaluation reads them."""
    found: dict[str, list[dict[str, Any]]] = {}
    for log in logs:
        found[log.name] = [
            frame(log.name, step, [row for row in getattr(log, side) if row["step"] == step])
            for step in range(log.num_steps)
        ]
    return found


def frame(name: str, step: int, rows: list[Row]) -> dict[str, Any]:
    """One sweep."""
    return {
        "seq_id": name, "timestamp_ns": step, "ego_translation_m": [0.0, 0.0, 0.0],
        "translation_m": np.array([row["xyz"] for row in rows]).reshape(-1, 3),
        "size": np.array([row["lwh"] for row in rows]).reshape(-1, 3), "yaw": np.array([row["yaw"] for row in rows]),
        "velocity_m_per_s": np.zeros((len(rows), 3)), "label": np.zeros(len(rows), int),
        "name": np.array([row["name"].upper() for row in rows], dtype="<U40"),
        "track_id": np.array([row["id"] for row in rows], int),
        "score": np.array([row["score"] for row in rows], float),
    }  # fmt: skip


def track(logs: list[Log]) -> dict[str, Any]:
    """HOTA and MOTA by class, tuned for each."""
    found: dict[str, Any] = {}
    classes = sorted({row["name"].upper() for log in logs for row in (*log.truth, *log.results)})
    for objective in ("HOTA", "MOTA"):
        truth = tracking.filter_max_dist(frames(logs, "truth"), 50)
        results = tracking.filter_max_dist(frames(logs, "results"), 50)
        with contextlib.redirect_stdout(io.StringIO()):
            thresholds, best, means = tracking._tune_score_thresholds(truth, results, objective, classes, 10)
        found[objective] = {"thresholds": thresholds, "best": best, "mean": means}
        if objective == "HOTA":
            kept = utils.filter_by_class_thresholds(results, thresholds)
            with contextlib.redirect_stdout(io.StringIO()), tempfile.TemporaryDirectory() as folder:
                out = tracking.evaluate_tracking(truth, kept, classes, "T", folder)
            combined = out["TrackEvalDataset"]["T"]["COMBINED_SEQ"]
            found["at_best"] = {
                name: {key: np.mean(combined[name][family][key]) for family, keys in KEYS.items() for key in keys}
                for name in classes
            }
    return found


def mine(logs: list[Log]) -> dict[str, Any]:
    """HOTA-Temporal and timestamp-balanced accuracy of each log, whose buses are what is looked for; scores are 1."""
    found = {}
    for log in logs:
        sides = []
        for side in ("truth", "results"):
            (own,) = frames([log], side).values()
            for one in own:
                kept = one["name"] == "BUS"
                one |= {key: value[kept] for key, value in one.items() if isinstance(value, np.ndarray)}
                one["label"] = np.full(int(kept.sum()), mining.REFERRED_OBJECT)
                one["score"] = np.ones(int(kept.sum()))
            sides.append(mining.relabel_sequence_ids({(f"{log.name:36}", "bus"): own}))
        with contextlib.redirect_stdout(io.StringIO()):
            hota, _, accuracy = mining.evaluate_scenario_mining(sides[1], sides[0], "HOTA", "")
        (found[log.name],) = ({"hota": h, "accuracy": a} for h, a in zip(hota.values(), accuracy.values(), strict=True))
    return found


def plain(value: Any) -> Any:
    """Numbers that JSON has."""
    if isinstance(value, dict):
        return {str(key): plain(own) for key, own in value.items()}
    if isinstance(value, list | tuple):
        return [plain(own) for own in value]
    return value.item() if isinstance(value, np.generic) else value


if __name__ == "__main__":
    numbers = {
        "detection": {name: detect(logs_of(plan)) for name, plan in PLANS.items()},
        "mining": mine(logs_of(PLANS["sparse"])),
        "tracking": {name: track(logs_of(plan)) for name, plan in PLANS.items() if name != "many"},
    }
    (Path(sys.argv[1]) / "av2_metrics.json").write_text(json.dumps(plain(numbers), indent=1) + "\n")
