"""Write what AB3DMOT's KITTI evaluation says: `kitti_3dmot.json` beside this file, or `kitti_3dmot_real.json`.

How to run, in an environment of its own (Python 3.11: from 3.12 on `sum` compensates rounding, and AB3DMOT compares
averages of scores with themselves):

    pip install numpy==2.4.6 scipy numba matplotlib==3.11.2
    python make_kitti_3dmot.py AB3DMOT_REPOSITORY [KITTI_TRACKING]

AB3DMOT_REPOSITORY is a clone of https://github.com/xinshuoweng/AB3DMOT that has commit 61f3bd7. Its files are checked
out to a temporary folder. What newer Python needs is put in their way, without a change to what is counted:
`xinshuo_io.fileparts`, which nothing here calls, is an empty module; what it compiles with numba runs as plain Python;
plots are left out (they stop where no recall is reached); the intersection over union of two boxes is remembered,
because it is asked for in each of 42 passes (FBENCH_PLAIN=1 turns that off, for timing).

Alone it evaluates made-up sequences; with KITTI_TRACKING, a folder with `label_02` and `evaluate_tracking.seqmap.val`,
results made by disturbing these labels.
"""

import importlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import types
from pathlib import Path
from typing import Any

COMMIT = "61f3bd72574093e367916c757b4747ca445f978c"
HERE = Path(__file__).parent.resolve()
FILES = (
    "scripts/KITTI/evaluate.py", "scripts/KITTI/munkres.py", "scripts/KITTI/mailpy.py", "AB3DMOT_libs/__init__.py",
    "AB3DMOT_libs/dist_metrics.py", "AB3DMOT_libs/box.py", "AB3DMOT_libs/kitti_oxts.py",
)  # fmt: skip
CASES = {"3D 0.25": (True, 0.25), "3D 0.5": (True, 0.5), "3D 0.7": (True, 0.7), "2D 0.5": (False, 0.5)}
FIELDS = (
    "MOTA", "MOTP", "MOTAL", "MODA", "MODP", "recall", "precision", "F1", "FAR", "MT", "PT", "ML", "tp", "itp", "fp",
    "fn", "ifn", "id_switches", "fragments", "n_gt", "n_igt", "n_gt_trajectories", "n_tr", "n_itr",
    "n_tr_trajectories",
)  # fmt: skip
COUNTS = ("tp", "itp", "fp", "fn", "ifn", "id_switches", "fragments", "n_gt", "n_tr", "n_itr")
REALS = ("threshold", "aim", "sMOTA")


def checked_out(repository: str, folder: Path) -> None:
    """Put those of AB3DMOT's files that the evaluation needs into `folder`."""
    for name in FILES:
        shown = subprocess.run(["git", "-C", repository, "show", f"{COMMIT}:{name}"], check=True, capture_output=True)
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(shown.stdout)


def loaded(folder: Path) -> Any:
    """Import the evaluation script."""
    os.environ["NUMBA_DISABLE_JIT"] = "1"  # what it marks so runs as plain Python in numba of its time
    io: Any = types.ModuleType("xinshuo_io")
    io.fileparts = None
    sys.modules["xinshuo_io"] = io
    sys.path[:0] = [str(folder / "scripts/KITTI"), str(folder)]
    script: Any = importlib.import_module("evaluate")
    script.mail = importlib.import_module("mailpy").Mail("")
    script.mail.msg = lambda text: None
    script.stat.plot = lambda self: None
    if not os.environ.get("FBENCH_PLAIN"):
        known: dict[tuple[int, int], tuple[object, object, float]] = {}
        plain = script.iou

        def remembered(a: object, b: object, metric: str) -> float:
            # every box lives as long as the evaluation of its class, so that its address is its name
            key = (id(a), id(b))
            if key not in known:
                known[key] = (a, b, plain(a, b, metric=metric))
            return known[key][2]

        script.iou = remembered
    return script


def evaluated(script: Any, name: str, is_3d: bool, threshold: float) -> dict[str, Any]:
    """Run the script on `results/KITTI/NAME`, and return for each class every pass and the averages."""
    found: dict[str, dict[str, Any]] = {}
    save, output = script.trackingEvaluation.saveToStats, script.stat.output

    def noted(self, dump, threshold=None, recall=None):  # type: ignore[no-untyped-def]
        own = found.setdefault(self.cls, {"recalls": {field: [] for field in COUNTS + REALS}})
        if threshold is None:
            own["best"] = {field: float(getattr(self, field)) for field in FIELDS}
        else:
            self.threshold, self.aim = threshold, recall
            for field, values in own["recalls"].items():
                values.append((int if field in COUNTS else float)(getattr(self, field)))
        save(self, dump, threshold, recall)

    def averaged(self):  # type: ignore[no-untyped-def]
        output(self)
        found[self.cls] |= {"sAMOTA": float(self.sAMOTA), "AMOTA": float(self.amota), "AMOTP": float(self.amotp)}

    script.trackingEvaluation.saveToStats, script.stat.output = noted, averaged
    try:
        script.evaluate(name, script.mail, "1", is_3d, not is_3d, threshold)
    finally:
        script.trackingEvaluation.saveToStats, script.stat.output = save, output
    return found


def write_made(folder: Path, made: Any) -> None:
    """Write made-up sequences where the script looks for them."""
    labels, results = folder / "scripts/KITTI/label", folder / "results/KITTI/made/data_0"
    for path in (labels, results):
        path.mkdir(parents=True)
    rows = []
    for seed, (name, num_frames) in enumerate(made.SEQUENCES.items()):
        truth, found = made.made_sequence(seed, num_frames, 9.0)
        (labels / f"{name}.txt").write_text("\n".join(truth) + "\n")
        (results / f"{name}.txt").write_text("\n".join(found) + "\n")
        rows.append(f"{name} empty 000000 {num_frames - 1:06d}")
    (folder / "scripts/KITTI/evaluate_tracking.seqmap.val").write_text("\n".join(rows))


def write_real(folder: Path, made: Any, kitti: Path) -> None:
    """Write real labels and results made from them where the script looks for them."""
    shutil.copytree(kitti / "label_02", folder / "scripts/KITTI/label")
    seqmap = kitti / "evaluate_tracking.seqmap.val"
    shutil.copy(seqmap, folder / "scripts/KITTI")
    made.disturbed_folder(kitti / "label_02", seqmap, folder / "results/KITTI/made/data_0")


def main() -> None:
    """Evaluate and write."""
    made = importlib.import_module("kitti_tracks_input")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        checked_out(sys.argv[1], folder)
        if len(sys.argv) > 2:
            write_real(folder, made, Path(sys.argv[2]).resolve())
        else:
            write_made(folder, made)
        os.chdir(folder)
        script = loaded(folder)
        report = {}
        for case, (is_3d, threshold) in CASES.items():
            start = time.perf_counter()
            report[case] = evaluated(script, "made", is_3d, threshold)
            sys.stderr.write(f"{case}: {time.perf_counter() - start:.1f} s\n")
        out = HERE / ("kitti_3dmot_real.json" if len(sys.argv) > 2 else "kitti_3dmot.json")
        out.write_text(json.dumps(report).replace("}, ", "},\n") + "\n")


if __name__ == "__main__":
    main()
