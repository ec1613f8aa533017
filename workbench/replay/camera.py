"""A camera, and where it stands when it follows a robot."""

from dataclasses import dataclass

import numpy as np

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.logs.schema import RunLog


@dataclass(frozen=True)
class Camera:
    """A camera without roll.

    Attributes:
        p_WC: its position in W, m, shape (3,).
        target: the point of W that it looks at, m, shape (3,).
        focal_length: pixels.
        width, height: of the picture, pixels.
    """

    p_WC: FloatArray
    target: FloatArray
    focal_length: float
    width: int
    height: int

    @property
    def axes(self) -> FloatArray:
        """Rows: right, down and forward in W, shape (3, 3)."""
        forward = (self.target - self.p_WC) / np.linalg.norm(self.target - self.p_WC)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(forward, right), forward])

    def project(self, points: FloatArray) -> FloatArray:
        """Points (..., 3) in W, m, as column, row (pixels) and inverse depth (1/m), shape (..., 3)."""
        p_C = (points - self.p_WC) @ self.axes.T
        inverse = 1.0 / np.maximum(p_C[..., 2], 1e-3)
        column = 0.5 * self.width + self.focal_length * p_C[..., 0] * inverse
        row = 0.5 * self.height + self.focal_length * p_C[..., 1] * inverse
        return np.stack([column, row, inverse], axis=-1)

    def rays(self) -> FloatArray:
        """Direction in W through each pixel with unit depth, shape (height, width, 3)."""
        right, down, forward = self.axes
        columns = (np.arange(self.width) + 0.5 - 0.5 * self.width) / self.focal_length
        rows = (np.arange(self.height) + 0.5 - 0.5 * self.height) / self.focal_length
        return forward + columns[None, :, None] * right + rows[:, None, None] * down


_FOLLOW_TIME = 0.15
"""Width (s) of the smoothing of the camera's path: it does not shake with the car."""
_CAMERA_SIDE = 0.45
"""Angle between the car's heading and the direction to the camera, rad."""


def camera_path(run_log: RunLog) -> FloatArray:
    """The point of the floor that stays in the middle of the picture, W, m, shape (n, 3)."""
    return _smooth(run_log.time, run_log.vector("com", "truth_m") * [1.0, 1.0, 0.0])


def camera_pose(azimuth: float, place: tuple[float, float, float]) -> tuple[FloatArray, FloatArray]:
    """Where a camera stands that follows a point of the floor, and what it looks at.

    Args:
        azimuth: direction to the camera, rad about z.
        place: `LoggedRun.camera_place`.

    Returns:
        Eye and target, both from that point, m, shape (3,).
    """
    distance, height, target = place
    eye = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), height])
    return eye, np.array([0.0, 0.0, target])


def camera_azimuth(run_log: RunLog) -> float:
    """Direction (rad about z) from the robot to the camera: ahead and to the outside of the turn, halfway through it.

    A plant without a base has no heading: the camera looks along y then, a little from the side.
    """
    if "yaw_truth_rad" not in run_log.table:
        return -0.5 * np.pi + _CAMERA_SIDE
    yaw = run_log.signal("yaw_truth_rad")
    final = float(np.clip(yaw[-1] - yaw[0], -np.pi / 2, np.pi / 2))
    side = -_CAMERA_SIDE if final >= 0 else _CAMERA_SIDE
    return float(yaw[0]) + 0.5 * final + side


def _smooth(time: FloatArray, path: FloatArray) -> FloatArray:
    """Path (n, 3) averaged with a Gaussian of `_FOLLOW_TIME`; its ends are continued straight on."""
    width = _FOLLOW_TIME / float(np.median(np.diff(time)))
    reach = min(int(np.ceil(3 * width)), len(path) - 1)
    if reach < 1:
        return path
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    kernel /= kernel.sum()
    padded = np.concatenate([2 * path[0] - path[reach:0:-1], path, 2 * path[-1] - path[-2 : -reach - 2 : -1]])
    return np.column_stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in range(3)])
