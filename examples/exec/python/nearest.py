"""A car where the LiDAR point nearest to the vehicle is that isn't of the ground.

`fbench replay LOG -p 'exec:python nearest.py 4'`
"""

import sys
import time

import numpy as np
from client import body_T_sensor, columns, run, schema


class Nearest:
    """Points nearer than `min_range_m` to the body's origin [m] are left out."""

    name = "nearest"

    def __init__(self, min_range_m: float) -> None:
        self.min_range_m = min_range_m

    def start(self, hello: schema.Hello) -> None:
        self.poses = {sensor.name: body_T_sensor(sensor) for sensor in hello.sensors}

    def reset(self, reason: str) -> None:
        print("reset:", reason)

    def step(self, frame: schema.Frame) -> schema.Output:
        begin = time.perf_counter_ns()
        output = schema.Output()
        output.in_3d.tracks.SetInParent()  # in 3D and tracked, also where nothing is found
        parts = [np.zeros((0, 3))]
        for message in frame.messages:
            if message.WhichOneof("content") == "points":
                pose = self.poses[message.sensor]
                parts.append(columns(message.points)["xyz"] @ pose[:3, :3].T + pose[:3, 3])
        xyz = np.concatenate(parts)
        distance = np.hypot(xyz[:, 0], xyz[:, 1])
        kept = (distance > self.min_range_m) & (xyz[:, 2] > 0.3)
        xyz, distance = xyz[kept], distance[kept]
        if len(xyz):
            for boxes in (output.in_3d.detections, output.in_3d.tracks):
                boxes.center_m.extend(xyz[np.argmin(distance)])
                boxes.size_lwh_m.extend([4.0, 1.8, 1.5])
                boxes.yaw_rad.append(0.0)
                boxes.label.append("car")
                boxes.score.append(1.0)
                boxes.track_id.append(1)
        output.stages.add(name="detect.lidar", duration_ns=time.perf_counter_ns() - begin)
        return output


if __name__ == "__main__":
    run(Nearest(float(sys.argv[1]) if len(sys.argv) > 1 else 3.0))
