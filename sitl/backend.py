"""The simulated vehicle behind the drivers' protocols, in place of serial lines and amplifiers."""

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Literal, Protocol

from autopilot.core.camera_tilt import TiltReports
from autopilot.core.errors import ConfigError
from autopilot.core.geodesy import Origin
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import FlightControllerState
from autopilot.core.samples import CameraFrame, PowerSample, Sample
from autopilot.core.toml_table import Vec2
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.base import AlwaysOpen, Closing
from autopilot.drivers.ig500 import Ig500
from autopilot.drivers.thruster_output import SafeThrusterOutput
from autopilot.sitl.ahrs import Ig500Emulator
from autopilot.sitl.camera_feed import CameraFeed, simulated_camera
from autopilot.sitl.camera_process import CameraProcess
from autopilot.sitl.contact import Prism
from autopilot.sitl.fault_tables import BatterySag, LateCommands, Shove, Snag
from autopilot.sitl.floor import build_markers
from autopilot.sitl.hil import BoardOutput, NetworkCamera, SerialAhrs, Wire
from autopilot.sitl.machine_faults import SharedThrusters
from autopilot.sitl.optional_sensors import SensedWorld, SimHullSensor, SimObstacleSensor, optional_sensors
from autopilot.sitl.payload_devices import SimPayload
from autopilot.sitl.plant import Truth
from autopilot.sitl.pose_sensor import SimPoseSensor
from autopilot.sitl.protocol import PlantContext, PlantLike, SteerablePlant, create_plant
from autopilot.sitl.scenario_tables import Fault, Scenario, ThrusterLoss
from autopilot.sitl.waves import wave_train

POWER_PERIOD_US = 500_000
"""The battery monitor reports at 2 Hz."""


class TruthSampler(Protocol):
    """A simulated device that samples the truth at times of its own."""

    @property
    def next_us(self) -> int:
        """Time of the next sample."""
        ...

    def observe(self, truth: Truth) -> None: ...


class FaultySensor(Protocol):
    """A simulated sensor that can fail while it runs."""

    def add(self, fault: Fault) -> bool:
        """A fault begins at its time; whether it is one of this sensor."""
        ...


class SimThrusterOutput(SafeThrusterOutput):
    """Pulses held for the plant."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self.pwm_us: tuple[int, ...] = self._neutral_us
        """What the amplifiers see now."""

    def _acquire(self) -> None:
        """No-op."""

    def _put(self, pwm_us: tuple[int, ...]) -> None:
        self.pwm_us = pwm_us

    def _release(self) -> None:
        """No-op."""


class CommandLine:
    """Command path from service to amplifiers: a delay queue in the order of sending."""

    def __init__(self, latency_s: float, neutral_us: tuple[int, ...], faults: Sequence[Fault] = ()) -> None:
        self._latency_us = round(latency_s * 1e6)
        self._late = [fault for fault in faults if isinstance(fault, LateCommands)]
        self._sent = self._now = neutral_us
        self._in_transit: deque[tuple[int, tuple[int, ...]]] = deque()

    def send(self, t_us: int, pwm_us: tuple[int, ...]) -> None:
        """From ``t_us`` on the service holds these pulses."""
        if pwm_us != self._sent:
            self._sent = pwm_us
            late_s = sum(fault.latency_s for fault in self._late if fault.holds(t_us))
            last_us = self._in_transit[-1][0] if self._in_transit else 0
            self._in_transit.append((max(last_us, t_us + self._latency_us + round(late_s * 1e6)), pwm_us))

    def until(self, begin_us: int, end_us: int) -> Iterator[tuple[int, tuple[int, ...]]]:
        """Pulses at the amplifiers between two times: ends of intervals and the pulses held until then."""
        while self._in_transit and self._in_transit[0][0] <= end_us:
            arrival_us, pulses = self._in_transit.popleft()
            if arrival_us > begin_us:
                yield arrival_us, self._now
            self._now = pulses
        yield end_us, self._now


class PowerMonitor(AlwaysOpen):
    """Voltage, current and energy at the battery's terminals."""

    def __init__(self) -> None:
        self.next_us = 0
        """When the next sample is taken."""
        self._samples: list[PowerSample] = []

    def observe(self, truth: Truth) -> None:
        self.next_us += POWER_PERIOD_US
        self._samples.append(
            PowerSample(
                t_us=truth.t_us,
                voltage_v=truth.voltage_v,
                current_a=truth.current_a,
                energy_used_j=truth.energy_used_j,
                remaining=truth.energy_remaining,
            )
        )

    def poll(self, t_us: int) -> list[PowerSample]:
        samples, self._samples = self._samples, []
        return samples


class SimulatedVehicle(Closing):
    """Plant, sensors and thruster output of one scenario. Time is handed in; the same calls give the same bytes."""

    def __init__(
        self,
        scenario: Scenario,
        vehicle: Vehicle,
        plant: PlantLike,
        *,
        seed: int,
        position: Literal["camera", "pose"],
        paced: bool = False,
        hil: frozenset[Wire] = frozenset(),
    ) -> None:
        """``position``: localised by rendered pictures or by pose samples. ConfigError if the scenario has no floor.
        ``hil``: which devices have a real driver and an operating system between them and the service."""
        sensors, faults = scenario.sensors, scenario.fault
        self._plant = plant
        self.thrusters = tuple(thruster.name for thruster in vehicle.thrusters)
        """Their names."""
        self.payload = SimPayload(vehicle)
        """What it carries."""
        self._t_us = 0
        self._truth: Truth | None = None
        plain = SimThrusterOutput(vehicle)
        self.output: SimThrusterOutput | BoardOutput = BoardOutput(vehicle) if "pwm" in hil else plain
        """A :class:`autopilot.drivers.protocols.ThrusterOutput`."""
        self._shared = SharedThrusters(faults)
        self._line = CommandLine(scenario.vehicle.command_latency_s, plain.pwm_us, faults)
        emulator = Ig500Emulator(sensors.ahrs, vehicle.ahrs, faults, seed)
        attitude = sensors.ahrs.attitude
        self._ahrs: Ig500 | SerialAhrs = (
            SerialAhrs(emulator, vehicle, attitude=attitude)
            if "serial" in hil
            else Ig500(emulator, vehicle.ahrs.latency_s, attitude=attitude)
        )
        self._power = PowerMonitor()
        self._pose: SimPoseSensor | None = None
        self._camera: CameraFeed | NetworkCamera | None = None
        self.markers: MarkerMap | None = None
        """The true marker map; None when there are no pictures."""
        self._observers: list[TruthSampler] = [emulator, self._power]
        self._obstacles = SimObstacleSensor(sensors.obstacles, scenario.obstacle, seed)
        if not self._obstacles.blind:
            self._observers.append(self._obstacles)
        depth_m = None if scenario.tank is None else scenario.tank.depth_m
        place = scenario.origin
        origin = Origin(lat_deg=place.lat_deg, lon_deg=place.lon_deg, alt_m=place.alt_m)
        world = SensedWorld(floor_depth_m=depth_m, waves=wave_train(scenario.waves, depth_m), origin=origin)
        self._optional = optional_sensors(sensors, vehicle, world, faults, seed)
        self._hull = SimHullSensor(sensors.hull, faults) if sensors.hull.enabled else None
        if self._hull is not None:
            self._observers.append(self._hull)
        self._observers += self._optional
        pictures: CameraFeed | CameraProcess | None = None
        if position == "pose":
            self._pose = SimPoseSensor(sensors.pose, sensors.laser, vehicle, depth_m, faults, seed)
            self._observers.append(self._pose)
        else:
            if "camera" in hil:
                pictures = CameraProcess(scenario, vehicle, seed)
                self._camera = NetworkCamera(pictures, vehicle)
            else:
                self._camera = pictures = simulated_camera(scenario, vehicle, seed)
                pictures.paced = paced
            self._observers.append(pictures)
            self.markers = build_markers(scenario)
        self._tilt_reports = TiltReports(vehicle)
        self._tilted: CameraFeed | CameraProcess | SimPoseSensor | None = None
        """The camera that tilts with the payload."""
        if vehicle.tilt is not None and vehicle.tilt.camera_deg is not None:
            self._tilted = self._pose if pictures is None else pictures
        self._due_us = 0
        own: tuple[FaultySensor | None, ...] = (pictures, self._pose, self._hull, *self._optional)
        self._faulty = [sensor for sensor in own if sensor is not None]

    def open(self) -> None:
        """Configure the AHRS, start the renderer, thrusters to neutral."""
        self._ahrs.open()
        self.output.open()
        if self._camera is not None:
            self._camera.open()

    def close(self) -> None:
        """Thrusters to neutral, stop the renderer."""
        self.output.close()
        self._ahrs.close()
        if self._camera is not None:
            self._camera.close()

    @property
    def truth(self) -> Truth:
        if self._truth is None:
            self._truth = self._plant.truth
        return self._truth

    @property
    def ahrs(self) -> Ig500:
        return self._ahrs.driver if isinstance(self._ahrs, SerialAhrs) else self._ahrs

    # Steered by hand

    @property
    def steerable(self) -> SteerablePlant | None:
        """The plant, if it can be steered by hand."""
        return self._plant if isinstance(self._plant, SteerablePlant) else None

    def begin_fault(self, fault: Fault) -> None:
        """A fault begins that the scenario does not have. ConfigError if nothing here can have it."""
        plant = self.steerable
        if isinstance(fault, ThrusterLoss | Shove | Snag | BatterySag):
            if plant is None:
                raise ConfigError("this plant takes no faults while it runs; write it into the scenario")
            plant.begin_fault(fault)
        elif not any(sensor.add(fault) for sensor in self._faulty):
            kind = fault.__struct_config__.tag
            raise ConfigError(f"fault {kind} cannot begin while the simulation runs; write it into the scenario")

    @property
    def pictured(self) -> bool:
        """Whether it is localised by pictures."""
        return self._camera is not None

    def add_flow(self, flow_m_s: Vec2) -> None:
        """A flow is added to the current everywhere. ConfigError if the plant cannot."""
        plant = self.steerable
        if plant is None:
            raise ConfigError("the current of this plant cannot be changed")
        plant.add_flow(flow_m_s)
        self._truth = None

    def put_obstacle(self, number: int, north_m: float, east_m: float) -> None:
        """An obstacle stands elsewhere; the obstacle sensor reports it from now on. ConfigError if it cannot."""
        plant = self.steerable
        if plant is None:
            raise ConfigError("obstacles of this plant cannot be moved")
        plant.put_obstacle(number, north_m, east_m)
        self._truth = None
        solid = plant.solids[number - 1]
        if isinstance(solid, Prism):
            return
        self._obstacles.put(number, north_m, east_m, solid.radius_m)
        if self._obstacles not in self._observers:
            self._obstacles.begin(self._due_us)
            self._observers.append(self._obstacles)

    def advance(self, t_us: int) -> None:
        """Advance the plant to ``t_us`` with the last pulses; every sensor samples at its own times."""
        self.output.check(t_us)
        self.payload.advance(t_us)
        if self._tilted is not None:
            self._tilted.tilt(self.payload.camera_off_rad)
        while self._due_us <= t_us:
            due_us = self._due_us
            self._move(due_us)
            truth = self.truth
            for observer in self._observers:
                if observer.next_us == due_us:
                    observer.observe(truth)
            self._due_us = min([observer.next_us for observer in self._observers])
        self._move(t_us)

    def poll(self, t_us: int) -> tuple[Sample, ...]:
        """Samples that have arrived up to ``t_us``; the AHRS's are transmitted as bytes."""
        samples: list[Sample] = [*self._ahrs.poll(t_us), *self._power.poll(t_us)]
        if self._pose is not None:
            samples.extend(self._pose.poll(t_us))
        for sensor in (self._obstacles, *self._optional, self._hull):
            if sensor is not None:
                samples.extend(sensor.poll(t_us))
        samples.extend(self._tilt_reports.of_outputs(t_us, self.payload.pulses_us))
        return tuple(samples)

    def frames(self, t_us: int) -> list[CameraFrame]:
        """Pictures that have arrived up to ``t_us``."""
        return [] if self._camera is None else self._camera.poll(t_us)

    def write(self, pwm_us: Sequence[int]) -> None:
        self.output.write(self._t_us, pwm_us)
        self._shared.sent(self._t_us, self.output.pwm_us)

    def below(self, t_us: int, *, armed: bool) -> FlightControllerState | None:
        """State of a flight controller with output reports, if the scenario has one."""
        return self._shared.below(t_us, armed=armed)

    def _move(self, t_us: int) -> None:
        if t_us > self._t_us or self._truth is None:
            self._line.send(self._t_us, self._shared.pulses_us(self._t_us, self.output.pwm_us))
            for until_us, pulses in self._line.until(self._t_us, t_us):
                self._plant.advance(until_us, pulses)
            self._t_us = t_us
            self._truth = None


def simulated_vehicle(
    scenario: Scenario,
    vehicle: Vehicle,
    *,
    seed: int | None = None,
    position: Literal["camera", "pose"] | None = None,
    paced: bool = False,
    hil: frozenset[Wire] = frozenset(),
    plant: str | None = None,
    plant_asked_by: str | None = None,
) -> SimulatedVehicle:
    """The vehicle of a scenario with its plant; ``seed``, ``position`` and ``plant`` None = by the scenario.

    ``paced``: the caller does not wait for images, they are delivered when ready. ``plant_asked_by``: option or
    variable that named the plant, for errors.
    """
    seed = scenario.scenario.seed if seed is None else seed
    if plant is None:
        plant, plant_asked_by = scenario.plugins.plant, "`$.plugins.plant`"
    context = PlantContext(scenario=scenario, vehicle=vehicle, seed=seed)
    return SimulatedVehicle(
        scenario,
        vehicle,
        create_plant(plant, context, plant_asked_by),
        seed=seed,
        position=scenario.sensors.position if position is None else position,
        paced=paced,
        hil=hil,
    )
