"""What the supervision of a running joystick monitors, and how it reacts (docs/drivers.md)."""

from dataclasses import dataclass
from enum import Enum
from math import inf, isfinite, sqrt

import numpy as np

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.device.device import JoystickReading

#: Interval between readings of the thermometer, because motors heat up in minutes.
_CHECK_NS = 20 * NS_PER_MS
#: Median of the absolute value of a normal deviate, in standard deviations.
_MEDIAN = 0.6745


@dataclass(frozen=True, kw_only=True, slots=True)
class Limits:
    """Limits of the supervision; all chosen.

    warn_c, halt_c, cool_c: of the motors: less force, linearly; halted; until they are cooler.
    silence_ns: without a sample for longer it halts. outside_m: beyond the workspace. speed_m_s:
    faster than any hand.

    They lie below what a winding of class B bears (130 °C). They exceed what a hand may touch for
    ten minutes (48 °C, ISO 13732-1), because the housing stays cooler than the motors.
    """

    warn_c: float = 60.0
    halt_c: float = 80.0
    cool_c: float = 55.0
    least_share: float = 0.25  # of the force limit, just below `halt_c`
    silence_ns: int = 5 * NS_PER_S
    outside_m: float = 0.01
    speed_m_s: float = 8.0

    def __post_init__(self) -> None:
        if not self.cool_c < self.warn_c < self.halt_c:
            raise ValueError("cool_c < warn_c < halt_c is required")

    def share(self, temperature_c: float | None) -> float:
        """Return the share of the force limit, 0 to 1, that is left at this temperature."""
        if temperature_c is None or temperature_c <= self.warn_c:
            return 1.0
        if temperature_c >= self.halt_c:
            return 0.0
        into = (temperature_c - self.warn_c) / (self.halt_c - self.warn_c)
        return 1.0 - (1.0 - self.least_share) * into


#: The most noise of a place, as a standard deviation (µm). At 50 µm the force of a session jumps by
#: 1.7 N in a millisecond, at 100 µm by 3.9 N.
MOST_NOISE_UM = 20
#: So many readings are judged together. The handle rests if the mean moved by less than this from
#: their first half to the second (m). So many noisy ones in a row are too many.
_READINGS, _REST_M, _NOISY = 500, 0.0005, 3


class NoiseMeter:
    """Call `handle_place` for each reading: it returns, once, that a resting handle trembles."""

    def __init__(self) -> None:
        self._places: list[complex] = []
        self._noisy = 0

    def handle_place(self, x_m: float, y_m: float) -> str:
        self._places.append(complex(x_m, y_m))
        if len(self._places) < _READINGS:
            return ""
        places, half = np.array(self._places), _READINGS // 2
        self._places.clear()
        if abs(places[half:].mean() - places[:half].mean()) > _REST_M:
            return ""
        steps = np.diff(places, 2)
        # Medians, because a late reading is no noise. A second difference has 6 times the variance.
        median_m = float(np.median(np.abs([steps.real, steps.imag]), axis=1).max())
        noise_um = median_m / _MEDIAN / sqrt(6.0) * 1e6
        self._noisy = self._noisy + 1 if noise_um > MOST_NOISE_UM else 0
        if self._noisy != _NOISY:
            return ""
        return (
            f"the handle's place trembles by {noise_um:.0f} µm from one reading to the next: "
            f"filter it in the driver to {MOST_NOISE_UM} µm at most"
        )


class Health(Enum):
    """Severity of what the supervisor found."""

    OK = 0
    HALT = 1
    FAULT = 2
    FATAL = 3


class JoystickSupervisor:
    """Judges each reading. `health` and `reason` (one line) describe the newest one.

    expects_peer: whether silence of the peer counts; peer: who it is. Set by the caller.
    share: share of the force limit that the temperature leaves.
    warnings: how often `warn_c` was passed.
    hottest_c: highest temperature so far; None without a sensor.
    """

    def __init__(self, limits: Limits | None = None) -> None:
        self.limits = limits or Limits()
        self.health = Health.OK
        self.reason = ""
        self.share = 1.0
        self.expects_peer = False
        self.peer = "the robot"
        self.warnings = 0
        self.hottest_c: float | None = None
        self._temperature_c: float | None = None
        self._check_ns = 0
        self._hot = False
        self._heard_ns: int | None = None
        self._silent = False
        self._speed_m_s = self.limits.speed_m_s
        #: Until when a trainer's exercise lasts; None without one.
        self._exercise_ns: int | None = None
        self.forget_workspace()

    @property
    def plausible(self) -> tuple[float, float, float]:
        """Limits of plausible readings: |x| and |y| (m), and the speed per axis (m/s)."""
        return self._reach_x_m, self._reach_y_m, self._speed_m_s

    def handle_heard(self, now_ns: int) -> None:
        """A sample of the peer is fresh."""
        self._heard_ns = now_ns
        self._silent = False

    def forget_silence(self) -> None:
        """Restart the silence timer at the next reading."""
        self._heard_ns = None

    def handle_new_peer(self) -> None:
        """Another peer is asked: the silence of the one before counts no more."""
        self._heard_ns = None
        if self._silent:
            self._silent = False
            if self.health is Health.HALT and not self._hot:
                self._set_health(Health.OK, "")

    def set_workspace(self, half_width_m: float, half_height_m: float) -> None:
        """Judge positions from now on: the handle is calibrated to these half widths."""
        self._half_m = (half_width_m, half_height_m)
        self._set_reach()

    def handle_exercise(self, until_ns: int) -> None:
        """Judge every reading as a fault until `until_ns`: a trainer's exercise."""
        self._exercise_ns = until_ns
        self._set_reach()

    def _set_reach(self) -> None:
        half_width_m, half_height_m = self._half_m
        outside_m = self.limits.outside_m
        if self._exercise_ns is not None:
            # No place is plausible, so the usual case costs no further comparison.
            half_width_m = half_height_m = -1.0 - outside_m
        self._reach_x_m = half_width_m + outside_m
        self._reach_y_m = half_height_m + outside_m

    def forget_workspace(self) -> None:
        """Do not judge positions until the next calibration."""
        self.set_workspace(inf, inf)

    def handle_reading(self, reading: JoystickReading, now_ns: int) -> Health:
        """Judge `reading`."""
        x_m, y_m, vx_m_s, vy_m_s, _, _, temperature_c, present, error, _, _ = reading
        # One comparison each for the usual case; a NaN fails it as well.
        reach_x, reach_y, speed = self._reach_x_m, self._reach_y_m, self._speed_m_s
        if not (
            present
            and not error
            and -reach_x <= x_m <= reach_x
            and -reach_y <= y_m <= reach_y
            and -speed <= vx_m_s <= speed
            and -speed <= vy_m_s <= speed
            and (temperature_c is None or isfinite(temperature_c))
        ):
            if self._exercise_ns is None or not present:
                return self._judge_sensors(reading)
            if now_ns < self._exercise_ns:
                return self._set_health(Health.FAULT, "a sensor gives no valid reading")
            self._exercise_ns = None
            self._set_reach()
            return self.handle_reading(reading, now_ns)
        if temperature_c is not None and now_ns >= self._check_ns:
            self._check_ns = now_ns + _CHECK_NS
            self._handle_temperature(temperature_c)
        if self.expects_peer:
            if self._heard_ns is None:
                self._heard_ns = now_ns
            elif now_ns - self._heard_ns > self.limits.silence_ns:
                self._silent = True
        if self._hot or self._silent:
            if self.health is not Health.HALT:
                self._set_health(Health.HALT, self._halt_reason())
            return Health.HALT
        if self.health is not Health.OK:
            self._set_health(Health.OK, "")
        return Health.OK

    def _handle_temperature(self, temperature_c: float) -> None:
        limits, before_c = self.limits, self._temperature_c
        self._temperature_c = temperature_c
        if temperature_c > limits.warn_c and (before_c is None or before_c <= limits.warn_c):
            self.warnings += 1
        if self.hottest_c is None or temperature_c > self.hottest_c:
            self.hottest_c = temperature_c
        self.share = limits.share(temperature_c)
        if temperature_c >= limits.halt_c:
            self._hot = True
        elif temperature_c < limits.cool_c:
            self._hot = False

    def _halt_reason(self) -> str:
        if self._hot:
            return (
                f"the motors were at {self._temperature_c:.0f} °C: they may go on below "
                f"{self.limits.cool_c:.0f} °C"
            )
        return f"no sample from {self.peer} for {self.limits.silence_ns / NS_PER_S:g} s"

    def _judge_sensors(self, reading: JoystickReading) -> Health:
        if not reading.present:
            return self._set_health(Health.FATAL, "the device is gone: plug it in and restart")
        if reading.error:
            return self._set_health(Health.FAULT, reading.error)
        for axis, half_m in enumerate(self._half_m):
            name, position_m, speed_m_s = "xy"[axis], reading.position(axis), reading.speed(axis)
            if not (isfinite(position_m) and isfinite(speed_m_s)):
                return self._set_health(
                    Health.FAULT, f"axis {name} reads no number: its sensor fails, or is silent"
                )
            if abs(position_m) > half_m + self.limits.outside_m:
                return self._set_health(
                    Health.FAULT,
                    f"axis {name} reads {position_m * 1e3:+.0f} mm, the workspace ends at "
                    f"±{half_m * 1e3:.0f} mm",
                )
        if reading.temperature_c is not None and not isfinite(reading.temperature_c):
            return self._set_health(Health.FAULT, "the thermometer reads no number")
        return self._set_health(Health.FAULT, "the handle reads faster than a hand can move it")

    def _set_health(self, health: Health, reason: str) -> Health:
        self.health, self.reason = health, reason
        return health
