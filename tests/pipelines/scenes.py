"""Small scenes that LiDAR and radar see."""

import numpy as np


def road(z_m=-1.6):
    axis = np.arange(-40, 40, 0.8) + 0.13
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    return np.column_stack([x, y, np.full(len(x), z_m)])


def car_back(x_m, y_m, z_m=-1.6, width_m=1.8):
    """Points on the back of a car whose back is at `x_m`."""
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-width_m / 2, width_m / 2, 12), (0.4, 0.8, 1.2)))
    return np.column_stack([np.full(len(y), x_m), y + y_m, z + z_m])


def echoes(x_m, y_m, num=40, length_m=2.0):
    """Radar points on a car, spread along the line of sight."""
    place = np.linspace(0, length_m, num)
    return np.column_stack([x_m + place, y_m + 0.4 * np.sin(np.arange(num)), np.zeros(num)])


def surroundings(num=300):
    """Stationary radar points all around the field of view."""
    azimuth = np.linspace(-0.9, 0.9, num)
    distance = 15.0 + 30.0 * np.abs(np.sin(7.0 * np.arange(num)))
    return np.column_stack([distance * np.cos(azimuth), distance * np.sin(azimuth), np.full(num, 0.5)])


def radial(xyz, ego_mps, over_ground_mps=0.0):
    """Radial velocity of points that move radially, seen from a radar that drives forward."""
    return over_ground_mps - ego_mps * xyz[:, 0] / np.linalg.norm(xyz, axis=1)
