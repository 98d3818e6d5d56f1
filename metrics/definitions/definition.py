"""Metric definitions: the text that explains a metric."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Better = Literal["higher", "lower", "neither"]
SHARE = "0 to 1"


@dataclass(frozen=True)
class Source:
    """Where a definition is published."""

    authors: str
    year: int
    title: str
    url: str

    def __str__(self) -> str:
        return f"{self.authors} ({self.year}), {self.title}, {self.url}"


@dataclass(frozen=True)
class MetricDefinition:
    """What one number means."""

    name: str
    meaning: str
    formula: str
    range: str
    better: Better
    undefined: str  # When it is null; empty: never, or where all of a profile's rows are
    source: Source
    unit: str = "1"  # `1` for shares and counts
    is_count: bool = False
    by_profile: Mapping[str, str] = field(default_factory=dict)  # What is different in a profile


BERNARDIN = Source(
    "Bernardin, Stiefelhagen", 2008, "Evaluating Multiple Object Tracking Performance: The CLEAR MOT Metrics",
    "https://doi.org/10.1155/2008/246309",
)  # fmt: skip
RISTANI = Source(
    "Ristani, Solera, Zou, Cucchiara, Tomasi", 2016, "Performance Measures and a Data Set for Multi-Target Tracking",
    "https://arxiv.org/abs/1609.01775",
)  # fmt: skip
LUITEN = Source(
    "Luiten, Osep, Dendorfer, Torr, Geiger, Leal-Taixe, Leibe", 2020, "HOTA: A Higher Order Metric for Evaluating "
    "Multi-Object Tracking", "https://arxiv.org/abs/2009.07736",
)  # fmt: skip
TRACKEVAL = Source("Luiten, Hoffhues", 2020, "TrackEval 1.3.0", "https://github.com/JonathonLuiten/TrackEval")
MOTMETRICS = Source("Heindl et al.", 2017, "py-motmetrics 1.4.0", "https://github.com/cheind/py-motmetrics")
LI = Source(
    "Li, Huang, Nevatia", 2009, "Learning to Associate: HybridBoosted Multi-Target Tracker for Crowded Scene",
    "https://doi.org/10.1109/CVPR.2009.5206735",
)  # fmt: skip
CAESAR = Source(
    "Caesar et al.", 2020, "nuScenes: A Multimodal Dataset for Autonomous Driving, with nuscenes-devkit 1.2.0",
    "https://github.com/nutonomy/nuscenes-devkit",
)  # fmt: skip
WENG = Source(
    "Weng, Wang, Held, Kitani", 2020, "3D Multi-Object Tracking: A Baseline and New Evaluation Metrics",
    "https://arxiv.org/abs/1907.03961",
)  # fmt: skip
GEIGER = Source(
    "Geiger, Lenz, Urtasun", 2012, "Are we ready for Autonomous Driving? The KITTI Vision Benchmark Suite",
    "https://www.cvlibs.net/datasets/kitti",
)  # fmt: skip
SIMONELLI = Source(
    "Simonelli, Bulo, Porzi, Lopez-Antequera, Kontschieder", 2019, "Disentangling Monocular 3D Object Detection",
    "https://arxiv.org/abs/1905.12365",
)  # fmt: skip
LIN = Source(
    "Lin et al.", 2014, "Microsoft COCO: Common Objects in Context, with pycocotools 2.0.11",
    "https://cocodataset.org/#detection-eval",
)  # fmt: skip
RIJSBERGEN = Source(
    "van Rijsbergen", 1979, "Information Retrieval, 2nd edition", "http://www.dcs.gla.ac.uk/Keith/Preface.html"
)  # fmt: skip
FBENCH = Source("The fbench authors", 2026, "fbench, docs/metrics.md", "https://pypi.org/project/fbench")
