"""PointCloud2, Image and CompressedImage: read without rosbags, so that their bytes are copied once."""

from collections.abc import Callable, Mapping

from fbench.replay.data import Message
from fbench.replay.logs.codec import Origin, Probe
from fbench.replay.logs.ros import clouds, images
from fbench.replay.logs.ros.reads import Reads
from fbench.replay.logs.ros.sensor_messages import read_cloud, read_compressed_image, read_raw_image
from fbench.replay.raw_images import layout_name


def cloud_reads(encoding: str) -> Reads:
    """PointCloud2: radar scans where points have Doppler, else LiDAR sweeps."""

    def probe(data: memoryview) -> Probe:
        cloud = read_cloud(data, encoding)
        return Probe("radar" if clouds.is_radar(cloud) else "lidar", cloud.header.frame_id)

    def message(kind: str, data: memoryview, origin: Origin) -> Message:
        cloud = read_cloud(data, encoding)
        convert = clouds.radar if kind == "radar" else clouds.lidar
        return convert(cloud, cloud.header.stamp_ns, origin)

    return Reads(("lidar", "radar"), probe, message)


def raw_image_reads(encoding: str) -> Reads:
    """Image; a layout that can't be shown is refused at the first look."""

    def probe(data: memoryview) -> Probe:
        image = read_raw_image(data, encoding)
        layout_name(image.encoding)
        return Probe("camera", image.header.frame_id)

    def message(kind: str, data: memoryview, origin: Origin) -> Message:
        image = read_raw_image(data, encoding)
        return images.raw(image, image.header.stamp_ns, origin)

    return Reads(("camera",), probe, message)


def compressed_image_reads(encoding: str) -> Reads:
    """CompressedImage; depth images are refused at the first look."""

    def probe(data: memoryview) -> Probe:
        image = read_compressed_image(data, encoding)
        images.check_format(image)
        return Probe("camera", image.header.frame_id)

    def message(kind: str, data: memoryview, origin: Origin) -> Message:
        image = read_compressed_image(data, encoding)
        return images.compressed(image, image.header.stamp_ns, origin)

    return Reads(("camera",), probe, message)


BULK: Mapping[str, Callable[[str], Reads]] = {
    "sensor_msgs/msg/PointCloud2": cloud_reads,
    "sensor_msgs/msg/Image": raw_image_reads,
    "sensor_msgs/msg/CompressedImage": compressed_image_reads,
}
"""By type: what a channel with messages of an encoding can be decoded to."""
