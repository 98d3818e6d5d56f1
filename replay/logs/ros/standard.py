"""Message definitions that rosbags' stores lack, in their current versions, for logs that don't carry their own."""

from collections.abc import Mapping

_VISION: Mapping[str, str] = {
    "vision_msgs/msg/Detection2DArray": "std_msgs/Header header\nDetection2D[] detections",
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nDetection3D[] detections",
    "vision_msgs/msg/Detection2D":
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox2D bbox\nstring id",
    "vision_msgs/msg/Detection3D":
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nstring id",
    "vision_msgs/msg/ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/BoundingBox2D": "Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/msg/Pose2D": "Point2D position\nfloat64 theta",
    "vision_msgs/msg/Point2D": "float64 x\nfloat64 y",
}  # fmt: skip
_RADAR: Mapping[str, str] = {
    "radar_msgs/msg/RadarScan": "std_msgs/Header header\nRadarReturn[] returns",
    "radar_msgs/msg/RadarReturn":
        "float32 range\nfloat32 azimuth\nfloat32 elevation\nfloat32 doppler_velocity\nfloat32 amplitude",
    "radar_msgs/msg/RadarTracks": "std_msgs/Header header\nRadarTrack[] tracks",
    "radar_msgs/msg/RadarTrack":
        "unique_identifier_msgs/UUID uuid\ngeometry_msgs/Point position\ngeometry_msgs/Vector3 velocity\n"
        "geometry_msgs/Vector3 acceleration\ngeometry_msgs/Vector3 size\nuint16 classification\n"
        "float32[6] position_covariance\nfloat32[6] velocity_covariance\nfloat32[6] acceleration_covariance\n"
        "float32[6] size_covariance",
    "unique_identifier_msgs/msg/UUID": "uint8[16] uuid",
}  # fmt: skip
_TRANSFORMS: Mapping[str, str] = {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "tf/msg/tfMessage": "geometry_msgs/TransformStamped[] transforms",
}

DEFINITIONS: Mapping[str, str] = {**_VISION, **_RADAR, **_TRANSFORMS}
"""Text of the definition by full name. Layouts are those of vision_msgs 4, radar_msgs 0.2 and tf2_msgs."""
