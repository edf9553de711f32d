"""What names and units of columns say, in English and German."""

import pytest

from bristle.common.unit_names import COUNTS, unit_symbol
from bristle.records.headings import heading


@pytest.mark.parametrize(
    ("name", "unit", "quantity"),
    [
        ("Time [s]", "s", "time"),
        ("Zeit in ms", "ms", "time"),
        ("t_ms", "ms", "time"),
        ("timestamp_ns", "ns", "time"),
        ("field.header.stamp", None, "time"),
        ("log.time", None, "time"),
        ("Timestamp (µs)", "us", "time"),
        ("Winkel [°]", "deg", "position"),
        ("angle_deg", "deg", "position"),
        ("Istposition in mm", "mm", "position"),
        ("field.position0", None, "position"),
        ("Encoder (counts)", COUNTS, "position"),
        ("Lage [inc]", COUNTS, "position"),
        ("Drehzahl [U/min]", "rpm", "velocity"),
        ("Motordrehzahl", "rpm", "velocity"),
        ("speed_rpm", "rpm", "velocity"),
        ("Geschwindigkeit / mm/s", "mm/s", "velocity"),
        ("Winkelgeschwindigkeit [°/s]", "deg/s", "velocity"),
        ("velocity_rad_per_s", "rad/s", "velocity"),
        ("Speed actual value", None, "velocity"),
        ("Moment [Nm]", "N.m", "torque"),
        ("torque(mN·m)", "mN.m", "torque"),
        ("field.effort0", None, "torque"),
        ("Kraft [N]", "N", "force"),
        ("Motorstrom (A)", "A", "current"),
        ("motorCurrent", None, "current"),
        ("i_q", None, "current"),
        ("motor_current_A", "A", "current"),
        ("input_volts", None, "voltage"),
        ("duty [%]", "%", "voltage"),
        ("v", None, None),
        ("Channel A", None, None),
        ("phase_A", None, None),
        ("data(:,1)", None, None),
        ("load", None, None),
    ],
)
def test_names(name, unit, quantity):
    found = heading(name)
    assert (found.unit, found.quantity) == (unit, quantity)


def test_setpoints_and_what_is_neither_input_nor_output():
    assert heading("Sollwinkel [°]").setpoint
    assert heading("goal_position").setpoint
    assert not heading("Istwinkel [°]").setpoint
    assert heading("pos_error").unwanted
    assert heading("Motortemperatur [°C]").unwanted
    assert not heading("position").unwanted


def test_a_unit_apart_from_the_name_decides():
    assert heading("v", "m/s").quantity == "velocity"
    assert heading("v", "V").quantity == "voltage"
    assert not heading("Channel A", "V").named
    sensor = heading("Position", "V")
    assert (sensor.quantity, sensor.fits) == ("position", False)


@pytest.mark.parametrize(
    ("text", "symbol"),
    [
        ("Nm", "N.m"),
        ("[N·m]", "N.m"),
        ("N*m", "N.m"),
        ("mNm", "mN.m"),
        ("°", "deg"),
        ("Grad/s", "deg/s"),
        ("1/min", "rpm"),
        ("min^-1", "rpm"),
        ("U", "rev"),
        ("m/s^2", "m/s2"),
        ("m/s²", "m/s2"),
        ("Sekunden", "s"),
        ("V", "V"),
        ("furlong", None),
        ("", None),
        ("1.5", None),
    ],
)
def test_units_as_loggers_write_them(text, symbol):
    assert unit_symbol(text) == symbol
