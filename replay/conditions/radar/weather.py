"""Radar in rain, snow and fog: weaker echoes, of which some are lost, and clutter of drops."""

from dataclasses import replace

import numpy as np

from fbench.replay.conditions.points import keep_points, polar
from fbench.replay.conditions.radar.echoes import Sensitivity
from fbench.replay.conditions.radar.false_echoes import add_clutter
from fbench.replay.conditions.weather import Weather, radar_loss_db
from fbench.replay.contracts.conditions import Site
from fbench.replay.data.messages import RadarScan

CLUTTER_PER_MM_H = 0.8  # False echoes a scan by rain, chosen: 40 at 50 mm/h


def disturb_scan(scan: RadarScan, weather: Weather, site: Site) -> RadarScan:
    """Return the scan as it would be in a weather, had it been recorded in clear air, at 77 GHz.

    Strengths fall by what the air takes there and back; those below the weakest that the sensor finds, by its own scan,
    are lost. Rain adds clutter in proportion to its rate.
    """
    range_m = polar(scan.xyz)[0]
    loss = radar_loss_db(weather, range_m) - radar_loss_db(Weather(), range_m)
    if not len(range_m) or not np.nanmax(loss, initial=0.0) > 0:
        return scan
    sensitivity = Sensitivity(scan)
    margin_db = sensitivity.margin_db + sensitivity.step_db * site.rng_of(scan, "margin").random(len(loss))
    found = ~(margin_db < loss)
    weak = scan
    if scan.rcs_dbsm is not None:
        weak = replace(scan, rcs_dbsm=(scan.rcs_dbsm - loss).astype(np.float32))
    return add_clutter(keep_points(weak, found), CLUTTER_PER_MM_H * weather.rain_mm_h, site.rng_of(scan, "clutter"))
