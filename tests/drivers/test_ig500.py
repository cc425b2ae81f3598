"""The AHRS driver: stamps, counters, configuration."""

import struct

import numpy as np

from autopilot.core.frames import quat_from_rpy
from autopilot.drivers.base import Closing
from autopilot.drivers.ig500 import Ig500
from autopilot.drivers.ig500_protocol import (
    AHRS_MASK,
    CONTINUOUS_OUTPUT,
    GET_OUTPUT_MASK,
    RETURN_OUTPUT_MASK,
    SET_CONTINUOUS_MODE,
    SET_OUTPUT_MASK,
    STATUS_GOOD,
    Ig500Parser,
    Ig500Status,
    OutputCodec,
    OutputField,
    encode_frame,
)
from autopilot.drivers.serial_sensor import REQUEST_AGAIN_POLLS

CODEC = OutputCodec(AHRS_MASK)


class ScriptedPort(Closing):
    """A byte port whose content the test writes down beforehand, and which says ``mask`` when it is asked."""

    def __init__(self, mask: int = AHRS_MASK) -> None:
        self.chunks: list[tuple[int, bytes]] = []
        self.written = b""
        self.mask = mask
        self._answers: list[tuple[int, bytes]] = []

    def open(self) -> None:
        pass

    def close(self) -> None:
        pass

    def read(self, t_us: int) -> list[tuple[int, bytes]]:
        due = [chunk for chunk in self.chunks if chunk[0] <= t_us]
        self.chunks = [chunk for chunk in self.chunks if chunk[0] > t_us]
        answers, self._answers = self._answers, []
        return answers + due

    def write(self, data: bytes) -> None:
        self.written += data
        if Ig500Parser().feed(data)[0].command == GET_OUTPUT_MASK:
            self._answers.append((0, encode_frame(RETURN_OUTPUT_MASK, struct.pack(">I", self.mask))))


def frame(device_ms: int, yaw_rad: float = 0.0, scale: float = 1.0, status: int = STATUS_GOOD) -> bytes:
    """One 0x90 frame; ``scale`` spoils the quaternion."""
    quat = scale * quat_from_rpy(np.array([0.01, -0.02, yaw_rad]))
    return encode_frame(
        CONTINUOUS_OUTPUT,
        CODEC.encode(
            {
                OutputField.QUATERNION: tuple(quat),
                OutputField.GYRO: (0.1, 0.2, 0.3),
                OutputField.ACCEL: (0.0, 0.1, -9.81),
                OutputField.TIME_SINCE_RESET: (device_ms,),
                OutputField.STATUS: (status,),
                OutputField.ATTITUDE_ACCURACY: (0.01,),
            }
        ),
    )


def test_configures_mask_before_output_and_reads_samples() -> None:
    port = ScriptedPort()
    with Ig500(port, latency_s=0.015) as driver:
        sent = Ig500Parser().feed(port.written)
        assert [f.command for f in sent] == [SET_OUTPUT_MASK, GET_OUTPUT_MASK, SET_CONTINUOUS_MODE]
        assert struct.unpack(">BI", sent[0].data)[1] == AHRS_MASK
        port.chunks = [(115_000, frame(100, 1.5))]
        assert driver.poll(110_000) == []
        (sample,) = driver.poll(120_000)
    assert sample.t_us == 100_000  # arrival minus declared latency
    np.testing.assert_allclose(sample.rpy_rad, [0.01, -0.02, 1.5], atol=1e-6)
    np.testing.assert_allclose(sample.rate_frd_rad_s, [0.1, 0.2, 0.3], atol=1e-6)
    np.testing.assert_allclose(sample.accel_frd_m_s2, [0.0, 0.1, -9.81], atol=1e-6)


def test_stamps_follow_the_device_clock_and_not_the_jitter_of_arrival() -> None:
    rng = np.random.default_rng(4)
    port = ScriptedPort()
    driver = Ig500(port, latency_s=0.015)
    driver.open()
    errors = []
    for k in range(1000):
        taken = 10_000 * k
        port.chunks = [(taken + 15_000 + int(rng.normal(0.0, 3_000.0)), frame(5_000 + 10 * k))]
        errors += [sample.t_us - taken for sample in driver.poll(taken + 60_000)]
    assert len(errors) >= 998
    settled = np.array(errors[200:])
    assert abs(settled.mean()) < 500
    assert settled.std() < 600  # the arrivals scatter by 3000


def test_useless_content_is_counted_and_dropped() -> None:
    port = ScriptedPort()
    driver = Ig500(port, latency_s=0.0)
    driver.open()
    port.chunks = [
        (1, frame(10, scale=1.2)),
        (2, encode_frame(CONTINUOUS_OUTPUT, b"too short")),
        (3, frame(20)),
        (4, frame(20)),
        (5, encode_frame(0x01, b"\x00\x00")),
        (6, frame(30)[:-1] + b"\x00"),
    ]
    assert len(driver.poll(10)) == 1
    assert driver.bad_samples == 3  # no rotation, wrong size, same time again
    driver.poll(11)
    port.chunks = [(12, bytes(600))]
    driver.poll(12)
    assert driver.bad_frames >= 1


def test_configures_again_when_the_device_falls_silent() -> None:
    port = ScriptedPort()
    driver = Ig500(port, latency_s=0.0)
    driver.open()
    for k in range(REQUEST_AGAIN_POLLS - 1):
        driver.poll(k)
    assert driver.configured_count == 1
    driver.poll(REQUEST_AGAIN_POLLS)
    assert driver.configured_count == 2
    assert len(Ig500Parser().feed(port.written)) == 6


def test_measurements_count_only_once_the_device_has_said_its_mask() -> None:
    port = ScriptedPort(
        mask=AHRS_MASK ^ OutputField.GYRO ^ OutputField.MAG
    )  # a mask of the same size: nothing else would show it
    driver = Ig500(port, latency_s=0.0)
    driver.open()
    port.chunks = [(1, frame(10)), (2, frame(20))]
    assert driver.poll(5) == []
    port.mask = AHRS_MASK
    for k in range(REQUEST_AGAIN_POLLS):
        driver.poll(10 + k)
    port.chunks = [(200, frame(30))]
    assert len(driver.poll(200)) == 1


def test_a_device_that_was_without_power_is_configured_again_at_once() -> None:
    port = ScriptedPort()
    driver = Ig500(port, latency_s=0.0)
    driver.open()
    port.chunks = [(1, frame(50_000)), (2, frame(10)), (3, frame(20))]
    assert len(driver.poll(5)) == 1
    assert driver.configured_count == 2
    port.chunks = [(10, frame(30))]
    assert len(driver.poll(10)) == 1


def test_says_what_is_not_in_order_by_the_device_s_own_account() -> None:
    port = ScriptedPort()
    driver = Ig500(port, latency_s=0.0)
    driver.open()
    assert driver.warnings == []
    port.chunks = [(1, frame(10, status=STATUS_GOOD & ~Ig500Status.ACCEL_RANGE))]
    driver.poll(1)
    assert driver.warnings == ["accel_range"]
    port.chunks = [(2, frame(20))]
    driver.poll(2)
    assert driver.warnings == []
