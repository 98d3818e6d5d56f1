"""Detection by all radars of a rig, timed: from a frame to what they see."""

from dataclasses import replace

import numpy as np

from fbench.pipelines.points import radar
from fbench.pipelines.points.doppler import velocity_periods, with_logged_ego_motion
from fbench.pipelines.points.merged import radar_scans
from fbench.pipelines.points.radar import Compensated, RadarParams, RadarView
from fbench.pipelines.stages import StageClock
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Frame, LogInfo, Rig
from fbench.replay.sensor_settings import SensorSettings


class RadarStage:
    """Knows with which period the velocities of each radar alias.

    Raises:
        LogError: where the log's metadata give a period that is none.
    """

    def __init__(self, rig: Rig, log_info: LogInfo, params: RadarParams, settings: SensorSettings) -> None:
        self._rig, self._params = rig, radar.scoring(params, log_info)
        self._own = {
            name: replace(own, doppler=with_logged_ego_motion(name, log_info, own.doppler))
            for name, own in settings.own("radar", params, radar.OWN).items()
        }
        self._periods = {
            name: velocity_periods((name,), log_info, own.doppler)[name] for name, own in self._own.items()
        }

    def view(self, frame: Frame, clock: StageClock) -> RadarView:
        """Detect in the echoes of one frame; without radar nothing is seen."""
        echoes = self.echoes(frame, clock)
        if echoes is None:
            return RadarView(np.zeros((0, 3)), np.zeros(0, np.int64), Boxes3D.empty())
        with clock.stage("detect.radar"):
            return radar.detect(echoes, self._params)

    def echoes(self, frame: Frame, clock: StageClock) -> Compensated | None:
        """Echoes of all radars of one frame with the ego motion taken out; `None` where no radar delivered."""
        with clock.stage("calibrate"):
            scans = radar_scans(self._rig, frame, self._periods)
        if scans is None:
            return None
        with clock.stage("preprocess"):
            return radar.compensate(scans, self._own)
