"""The common safety rule of all thruster outputs.

Thrusters are neutral before the first command, after the last, after an error, and when no command has arrived for the
vehicle file's ``drive.command_timeout_s``. A back end only implements the output of pulses.
"""

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence

from autopilot.core.errors import ConfigError, DriverError
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.base import Closing

INSPECT_EVERY = 25
"""Commands between two checks of a device that acknowledges commands even when it does not follow them (0.25 s)."""


def check_names(option: str, given: Iterable[str], known: Iterable[str]) -> None:
    """ConfigError if an option names something outside of ``known``."""
    known = tuple(known)
    unknown = sorted(set(given) - set(known))
    if unknown:
        raise ConfigError(f"`{option}` names {unknown[0]!r}, which is no thruster; use one of {', '.join(known)}")


class SafeThrusterOutput(Closing):
    """Template of a thruster output: derive from it and give :meth:`_acquire`, :meth:`_put` and :meth:`_release`."""

    def __init__(self, vehicle: Vehicle, spare: Mapping[int, int] | None = None) -> None:
        """``spare``: channel -> which of the vehicle's ``payload`` is on it; a back end without such has none."""
        self.vehicle = vehicle
        thrusters = vehicle.thrusters
        self._channels = tuple(thruster.channel for thruster in thrusters)
        self._spare = dict(spare or {})
        self._spare_us = {channel: vehicle.payload[index].start_us for channel, index in self._spare.items()}
        self._places = tuple(
            self._channels.index(channel) if channel in self._channels else None
            for channel in range(1, max((*self._channels, *self._spare)) + 1)
        )
        drives = [thruster.drive for thruster in thrusters]
        self._ends_us = tuple((drive.neutral_us - drive.span_us, drive.neutral_us + drive.span_us) for drive in drives)
        longest = [high for _, high in self._ends_us]
        self._longest_us = max(longest + [vehicle.payload[index].max_us for index in self._spare.values()])
        """The longest pulse that may be commanded."""
        self._rest_us = [drive.neutral_us for drive in drives]
        self._timeout_us = round(min(drive.command_timeout_s for drive in drives) * 1e6)
        self._last_us: int | None = None
        self._open = False
        self._at_rest = False
        self._writes = 0
        self._suspect = False
        self.stale_count = 0
        """Number of timeouts of commands."""
        self.clamped_count = 0
        """Pulses that were outside neutral +- span and were cut to it."""
        self.failed_neutral_count = 0
        """Number of times neutral could not be sent; the amplifiers' own timeout then stops the thrusters."""

    @abstractmethod
    def _acquire(self) -> None:
        """Open the device (DriverError if it cannot be had)."""

    @abstractmethod
    def _put(self, pwm_us: tuple[int, ...]) -> None:
        """Put one pulse per channel [us] on the wire, 0 = none. May raise DriverError or OSError."""

    def _inspect(self) -> None:
        """Ask the device whether it still follows commands. DriverError or OSError if not; nothing: cannot."""

    @abstractmethod
    def _release(self) -> None:
        """Close the device, which may be half open or gone; the outputs are neutral where that was possible. Never
        raises."""

    def _check_rate(self, rate_hz: float, longest_us: float, most_us: float) -> None:
        """ConfigError if pulses at that rate are too short for the longest."""
        if longest_us >= most_us:
            raise ConfigError(f"`rate_hz` = {rate_hz:g}: a pulse of {longest_us:g} us does not fit; use a lower one")

    @property
    def _neutral_us(self) -> tuple[int, ...]:
        """Pulses by channel with thrusters neutral and payload unchanged [us]."""
        return self._by_channel(self._rest_us)

    def unwired(self) -> dict[str, str]:
        """Payload that this output cannot drive."""
        wired = set(self._spare.values())
        return {
            output.name: "the thruster output has no channel for it"
            for index, output in enumerate(self.vehicle.payload)
            if index not in wired
        }

    def set_payload(self, t_us: int, pulses_us: Sequence[int]) -> None:
        """Pulses of the payload [us], effective with the next command."""
        for channel, index in self._spare.items():
            output = self.vehicle.payload[index]
            self._spare_us[channel] = min(max(int(pulses_us[index]) or output.start_us, output.min_us), output.max_us)

    def open(self) -> None:
        """Open the device and set it to neutral. DriverError or OSError if it cannot be had; it is closed then."""
        if self._open:
            return
        try:
            self._acquire()
            self._put(self._neutral_us)
        except BaseException:
            self._release()
            raise
        self._open, self._at_rest, self._suspect, self._last_us = True, True, False, None

    def write(self, t_us: int, pwm_us: Sequence[int]) -> None:
        """Command one pulse per thruster [us]. DriverError (and neutral) if too few, closed, or the wire fails."""
        if not self._open:
            raise DriverError("thruster output is closed; open it before writing")
        count = len(self._channels)
        if len(pwm_us) < count:
            self.neutral()
            raise DriverError(f"{len(pwm_us)} pulses for {count} thrusters; give one per thruster")
        wanted = [int(pulse) for pulse in pwm_us[:count]]
        sent = [
            high if pulse > high else max(low, pulse) for pulse, (low, high) in zip(wanted, self._ends_us, strict=True)
        ]
        if sent != wanted:
            self.clamped_count += sum(a != b for a, b in zip(wanted, sent, strict=True))
        self._at_rest = False
        self._writes += 1
        try:
            if self._suspect or self._writes % INSPECT_EVERY == 0:
                self._suspect = (
                    True  # and stays so until it passes, lest the commands between checks seem to get through
                )
                self._inspect()
                self._suspect = False
            self._put(self._by_channel(sent))
        except (DriverError, OSError) as error:
            self._try_neutral()
            remedy = "" if isinstance(error, DriverError) else "; check cable and power"
            raise DriverError(f"thruster output failed: {error}{remedy}") from error
        self._last_us = t_us

    def check(self, t_us: int) -> bool:
        """To be called every tick: neutral when the last command is too old; True while it is.

        Does not raise: a neutral that does not get through is counted and tried again at the next tick.
        """
        if self._last_us is not None:
            if t_us - self._last_us <= self._timeout_us:
                return False
            self.stale_count += 1
            self._last_us = None
        if self._open and not self._at_rest:
            self._try_neutral()
        return True

    def neutral(self) -> None:
        """Stop all thrusters now; a fresh command starts them again. DriverError if the wire fails."""
        if self._open and not self._try_neutral():
            raise DriverError("thruster output failed: neutral did not get through; check cable and power")

    def close(self) -> None:
        """Neutral, then let go of the device. Idempotent; the device is let go of even when neutral fails."""
        if self._open:
            self._try_neutral()
            self._open = False
            self._release()

    def _by_channel(self, pulses_us: Sequence[int]) -> tuple[int, ...]:
        """Pulses of thrusters and payload by channel [us]; 0 on unused channels."""
        pulses = [0 if place is None else pulses_us[place] for place in self._places]
        for channel, pulse_us in self._spare_us.items():
            pulses[channel - 1] = pulse_us
        return tuple(pulses)

    def _try_neutral(self) -> bool:
        """Neutral if the wire still takes it; whether it did."""
        self._last_us = None
        try:
            self._put(self._neutral_us)
        except (DriverError, OSError):
            self.failed_neutral_count += 1
            return False
        self._at_rest = True
        return True
