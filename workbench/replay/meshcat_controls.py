"""Sliders, keys and gamepad of a Meshcat page as the controls of a car; see `hand_drive`."""

import math
from collections.abc import Callable

from pydrake.geometry import Meshcat

from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.controllers.manoeuvre import throttle_line
from aerodima.workbench.replay.hand_drive import SLICE, Shown, Wishes

STEERING, SPEED, NEXT_TURN, TAIL = "steering, deg", "wanted speed, m/s", "next turn: left 1, right -1", "tail roll, deg"
PACE, PACE_NOW, SPEED_NOW = "pace wanted", "pace now, 1 = real time", "speed now, m/s"
TIME_NOW, HEADING_NOW = "time, s", "heading, deg, left +"
LONGEST = 3600.0
"""The time stops there on its slider, s; the run goes on."""
STRAIGHT, BY_HAND, PAUSE, RESET, END = "straight", "tail: hand or law", "pause", "reset", "end"
KEYS = {STRAIGHT: "Space", BY_HAND: "KeyT", PAUSE: "KeyP", RESET: "KeyR", END: "Escape"}
"""Button -> key; the sliders have their keys in `MeshcatControls`."""
HELP = """arrow keys: steer, and speed wanted; space: wheels straight; P: pause; R: reset; Escape: end
Q, E: announce a left or a right turn to the tail's law; T: tail by hand or by its law; A, D: roll it by hand
gamepad: left stick steers, right stick rolls the tail, the two triggers brake and accelerate"""
DEAD_ZONE = 0.08
"""Deflection of a stick that counts as none."""
LEFT_X, RIGHT_X = 0, 2
"""Axes of a gamepad in the standard layout of browsers (https://w3c.github.io/gamepad/#remapping)."""
BRAKE, ACCELERATE = 6, 7
"""Its buttons for the two triggers, from 0 to 1."""
PAD_ACCELERATION = 4.0
"""Change of the wanted speed with a trigger pulled, m/s in a second at real time."""


class MeshcatControls:
    """The driver's controls in a Meshcat page. A gamepad, where one is moved, goes before sliders and keys.

    Args:
        meshcat: gets the sliders and buttons.
        scenario: of the car: its steering limit and top speed.
        pace: seconds of the run per second.
        say: told when a gamepad comes and goes.
    """

    def __init__(self, meshcat: Meshcat, scenario: Scenario, pace: float, say: Callable[[str], None] = print) -> None:
        self._meshcat, self._say = meshcat, say
        self._limit = math.degrees(scenario.servo.limit)
        line = throttle_line(scenario)
        self._top = math.floor(2.0 * (line.gain + line.offset)) / 2.0
        self._pad, self._steering, self._pad_speed = False, 0.0, 0.0
        meshcat.AddSlider(STEERING, -self._limit, self._limit, 3.0, 0.0, "ArrowRight", "ArrowLeft")
        meshcat.AddSlider(SPEED, 0.0, self._top, 0.25, 0.0, "ArrowDown", "ArrowUp")
        meshcat.AddSlider(NEXT_TURN, -1.0, 1.0, 1.0, 0.0, "KeyE", "KeyQ")
        meshcat.AddSlider(TAIL, -120.0, 120.0, 5.0, 0.0, "KeyA", "KeyD")
        meshcat.AddSlider(PACE, 0.1, 1.0, 0.1, pace)
        meshcat.AddSlider(PACE_NOW, 0.0, 1.0, 0.01, 0.0)
        meshcat.AddSlider(SPEED_NOW, 0.0, math.ceil(self._top), 0.01, 0.0)
        meshcat.AddSlider(TIME_NOW, 0.0, LONGEST, 0.1, 0.0)
        meshcat.AddSlider(HEADING_NOW, -180.0, 180.0, 1.0, 0.0)
        for name, key in KEYS.items():
            meshcat.AddButton(name, key)
        self._straightened = 0

    def wishes(self) -> Wishes:
        """As of now."""
        meshcat = self._meshcat
        if (clicks := meshcat.GetButtonClicks(STRAIGHT)) != self._straightened:
            self._straightened = clicks
            meshcat.SetSliderValue(STEERING, 0.0)
        if not self._read_pad():
            self._steering = math.radians(meshcat.GetSliderValue(STEERING))
        by_hand = meshcat.GetButtonClicks(BY_HAND) % 2 == 1
        paused = meshcat.GetButtonClicks(PAUSE) % 2 == 1
        return Wishes(
            steering=self._steering,
            speed=self._pad_speed if self._pad else meshcat.GetSliderValue(SPEED),
            planned_turn=meshcat.GetSliderValue(NEXT_TURN),
            tail_roll=math.radians(meshcat.GetSliderValue(TAIL)) if by_hand else math.nan,
            pace=0.0 if paused else meshcat.GetSliderValue(PACE),
            attempt=meshcat.GetButtonClicks(RESET),
            over=meshcat.GetButtonClicks(END) > 0,
        )

    def show(self, now: Shown) -> None:
        """Each on its slider, the pace in Meshcat's own chart too."""
        self._meshcat.SetSliderValue(PACE_NOW, min(now.pace, 1.0))
        self._meshcat.SetSliderValue(SPEED_NOW, now.speed)
        self._meshcat.SetSliderValue(HEADING_NOW, math.degrees(now.heading))
        self._meshcat.SetSliderValue(TIME_NOW, min(now.time, LONGEST))
        self._meshcat.SetRealtimeRate(now.pace)

    def _read_pad(self) -> bool:
        """Takes what a gamepad says; whether one is there."""
        meshcat, pad = self._meshcat, self._meshcat.GetGamepad()
        there = pad.index is not None and len(pad.axes) > RIGHT_X and len(pad.button_values) > ACCELERATE
        if there != self._pad:
            self._pad, self._pad_speed = there, meshcat.GetSliderValue(SPEED)
            self._say("gamepad: it drives now" if there else "the gamepad is gone: wheels straight, wanted speed 0")
            if not there:
                meshcat.SetSliderValue(STEERING, 0.0)
                meshcat.SetSliderValue(SPEED, 0.0)
        if not there:
            return False
        left, right = (value if abs(value) > DEAD_ZONE else 0.0 for value in (pad.axes[LEFT_X], pad.axes[RIGHT_X]))
        self._steering = -math.radians(self._limit) * left
        pulled = pad.button_values[ACCELERATE] - pad.button_values[BRAKE]
        self._pad_speed = min(self._top, max(0.0, self._pad_speed + PAD_ACCELERATION * pulled * SLICE))
        meshcat.SetSliderValue(SPEED, self._pad_speed)
        if right:
            meshcat.SetSliderValue(TAIL, 120.0 * right)
        return True
