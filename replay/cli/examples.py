"""Examples shown by `--help`; those that tests run are in the docs."""

_HEAD = "[bold]Examples[/bold]\n\n"

DEMO = f"{_HEAD}fbench demo\n\nfbench demo --out /tmp/demo\n\nfbench demo --split test -o runs/suite"
INIT = f"{_HEAD}fbench init log.mcap\n\nfbench init log.mcap -o configs/car.toml --overwrite"
REPLAY = (
    f"{_HEAD}fbench replay log.mcap --pipeline lidar3d\n\n"
    "fbench replay log.mcap -p late3d --set camera.weights=yolox.onnx --rate 2 -o runs/mine --report\n\n"
    "fbench replay log.mcap -p my_pipeline.py:MyPipeline\n\n"
    "fbench replay log.mcap -p 'exec:./my_stack --fast' --truth labels.csv\n\n"
    "fbench replay log.mcap -p recorded:/perception/tracks"
)
SCORE = (
    f"{_HEAD}fbench score runs/log-lidar3d\n\nfbench score runs/log-lidar3d --range-m 80 --all-around\n\n"
    "fbench score runs/log-lidar3d --truth label_02/0003.txt\n\n"
    "fbench score runs/log-lidar3d --explain 12\n\n"
    "fbench score runs/city1-late3d runs/city2-late3d --intervals 1000 -o together.json\n\n"
    "fbench score runs/log-lidar3d --profile kitti-3dmot --match iou3d:0.25\n\n"
    "fbench score --truth label_02 --detections tracker/data --profile trackeval-kitti -o scores.json\n\n"
    "fbench score --truth MOT17/train --detections results --profile trackeval-mot --sequences MOT17-02,MOT17-04\n\n"
    "fbench score --truth truth.json --detections submission.json --profile nuscenes-detection --json"
)
REPORT = f"{_HEAD}fbench report runs/log-lidar3d\n\nfbench report runs/log-lidar3d runs/log-late3d -o both.html"
COMPARE = f"{_HEAD}fbench compare runs/base runs/head\n\nfbench compare runs/base runs/head --tolerance 0.01"
VERIFY = (
    f"{_HEAD}fbench verify log.mcap -p lidar3d\n\n"
    "fbench verify log.mcap -p my_pipeline.py:MyPipeline --quick --repeat 3 --frames :50"
)
PLUGINS = (
    f"{_HEAD}fbench plugins\n\nfbench plugins pipelines late3d\n\nfbench plugins metrics hota\n\n"
    "fbench plugins profiles kitti-3dmot"
)
LOG_INFO = f"{_HEAD}fbench log info log.mcap\n\nfbench log info log.mcap --json"
LOG_CHECK = (
    f"{_HEAD}fbench log check log.mcap\n\nfbench log check log.mcap -p late3d --timeout-ms 50\n\n"
    "fbench log check log.bag --ignore LOG006 --json"
)
LOG_PREVIEW = (
    f"{_HEAD}fbench log preview log.mcap\n\nfbench log preview log.mcap -o pictures --frames 100:200 --num 4\n\n"
    "fbench log preview log.bag --offset lidar=-50 --topics '!rear*' --overwrite"
)
LOG_CONVERT = (
    f"{_HEAD}fbench log convert drive.mcap -o drive.parquet\n\n"
    "fbench log convert drive.bag -o part.mcap --from 12.5 --to 20 --topics '/lidar*'\n\n"
    "fbench log convert drive.mcap -o drive --split-s 60"
)
LOG_IMPORT = (
    f"{_HEAD}fbench log import astyx path/to/astyx -o astyx.mcap\n\n"
    "fbench log import nuscenes path/to/nuscenes -o logs --scenes 'scene-01*' --skip-bad\n\n"
    "fbench log import kitti path/to/tracking -o 0012.mcap --scenes 0012 --detections results"
)
LOG_EXPORT = (
    f"{_HEAD}fbench log export runs/0003-lidar3d --format kitti-tracking --class Car -o results/data\n\n"
    "fbench log export kitti/0000.mcap kitti/0001.mcap --format kitti-tracking -o label_02\n\n"
    "fbench log export runs/scene-*-late3d --format nuscenes -o submission.json"
)
LOG_SIMULATE = (
    f"{_HEAD}fbench log simulate urban --condition fog --seconds 10 --seed 3 -o fog.mcap\n\n"
    "fbench log simulate highway --sensors 'lidar,radar' --set weather.rain_mm_h=30 -o rain.mcap\n\n"
    "fbench log simulate suite --split test -o suite"
)
WEIGHTS_LIST = f"{_HEAD}fbench weights list\n\nfbench weights list --json"
WEIGHTS_GET = (
    f"{_HEAD}fbench weights get deimv2-femto\n\n"
    "fbench weights get yolox-tiny --from downloads/yolox_tiny.onnx\n\n"
    "fbench replay log.mcap -p late3d --set camera.weights=deimv2-femto"
)
WEIGHTS_TRAIN = (
    f"{_HEAD}fbench log simulate training -o training\n\n"
    "fbench weights train training -o city.onnx\n\n"
    "fbench replay log.mcap -p camera2d --set camera.weights=city.onnx"
)
