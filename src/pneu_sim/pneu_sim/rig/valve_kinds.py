# SPDX-License-Identifier: Apache-2.0
"""Valves as robots have them, each written with a few fields and drawn out as ports and a spool.

Every kind becomes the general valve (`pneu_sim.rig.schema.Valve`) as the file is read. Models,
identification and the bridge know that one only.
"""

from abc import ABC, abstractmethod
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from pneu_sim.channels import Channel
from pneu_sim.parts import Finite, NonNegative, Part, Positive, Ratio

SWITCH_STEP_S = 1.25e-4
"""What is switched and what regulates is resolved to this: a sixteenth of a pulse of 2 ms."""
BAND = 0.1
DEAD = 0.002
"""Shares of its range that a regulator is assumed to need to open fully, and not to act within."""

KINDS = ("general", "5/3", "3/3", "3/2", "2/2", "regulator")


class Switch(Part):
    """How a command becomes one of two voltages that the spool is told.

    Attributes:
        off_v: The one where the switch is off.
        on_v: The one where it is on.
        threshold_v: Command beyond which it is on, as seen from ``off_v``.
        pwm_hz: Frequency of a pulse width modulation, whose duty from 0 to 1 the command then is: a
            period begins at every whole number of them from time zero, switches on, and off again
            after the share of it that was commanded as it began. None compares with the threshold.
    """

    off_v: Finite = 0.0
    on_v: Finite = 24.0
    threshold_v: Finite = 12.0
    pwm_hz: Positive | None = None

    @model_validator(mode="after")
    def _check(self) -> "Switch":
        if self.off_v == self.on_v:
            raise ValueError(f"off_v and on_v are both {self.on_v:g}; they need to differ")
        return self


class Regulation(Part):
    """How a valve holds the pressure at its outlet; the opening of its fill is the set-point.

    The outlet is the node that the port ``fill`` leads to and ``vent`` starts from. The opening
    curve of the fill, from 0 to 1, is the share of the pressure range that a command asks for. The
    ports open as far as the measured pressure asks, one at a time.

    Attributes:
        fill: Port that fills the outlet.
        vent: Port that empties it.
        low_pa: Pressure at opening 0 of the fill's curve.
        high_pa: Pressure at opening 1.
        dead_zone_pa: Within this of the set-point, either way, nothing opens.
        full_open_pa: By how much more a port is fully open; between, it opens in proportion.
        bandwidth_hz: Bandwidth with which its spool follows, a first-order lag.
        sensor_lag_s: First-order lag of its own pressure sensor.
        integral_s: Time in which a deviation beyond the dead zone opens a port as far once more; it
            is forgotten as fast within the dead zone. None has no integral term.
    """

    fill: str
    vent: str
    low_pa: Positive
    high_pa: Positive
    dead_zone_pa: NonNegative
    full_open_pa: Positive
    bandwidth_hz: Positive = 50.0
    sensor_lag_s: NonNegative = 0.002
    integral_s: Positive | None = None

    @model_validator(mode="after")
    def _check(self) -> "Regulation":
        if self.fill == self.vent:
            raise ValueError(f"fill and vent are both {self.fill!r}; they need to be two ports")
        if self.low_pa >= self.high_pa:
            raise ValueError(f"low_pa {self.low_pa:g} must be below high_pa {self.high_pa:g}")
        return self


class _Kind(Part, ABC):
    """What all kinds share.

    Attributes:
        command: Name of the command it follows.
        supply: Node that it supplies from.
        conductance_m3_s_pa: Sonic conductance of a path from the supply.
        critical_ratio: Critical pressure ratio of it.
        leakage: Opening fraction that remains of a closed path.
    """

    command: str
    supply: str
    conductance_m3_s_pa: Positive
    critical_ratio: Ratio = 0.3
    leakage: NonNegative = 0.0

    def _path(self, start: str, end: str, opening: dict[str, Any]) -> dict[str, Any]:
        """A port from the supply."""
        return {
            "from": start,
            "to": end,
            "conductance_m3_s_pa": self.conductance_m3_s_pa,
            "critical_ratio": self.critical_ratio,
            "leakage": self.leakage,
            "opening": opening,
        }

    @abstractmethod
    def general(self) -> dict[str, Any]:
        """Returns the same valve as the fields of the general one."""


class _Venting(_Kind):
    """What kinds with an exhaust share.

    Attributes:
        exhaust_conductance_m3_s_pa: Sonic conductance of an exhaust path.
        exhaust_critical_ratio: Its critical pressure ratio.
    """

    exhaust_conductance_m3_s_pa: Positive | None = None
    exhaust_critical_ratio: Ratio | None = None

    def _vent(self, start: str, end: str, opening: dict[str, Any]) -> dict[str, Any]:
        """A port to an exhaust."""
        path = self._path(start, end, opening)
        if self.exhaust_conductance_m3_s_pa is not None:
            path["conductance_m3_s_pa"] = self.exhaust_conductance_m3_s_pa
        if self.exhaust_critical_ratio is not None:
            path["critical_ratio"] = self.exhaust_critical_ratio
        return path


class _Sliding(_Venting):
    """A spool that slides to either side of a centre.

    Attributes:
        position: Where the spool's measured position is recorded.
        command_v: Command of one end and of the other.
        centre_v: Command of the centre.
        centre: What the outlets meet there.
        centre_opening: Share of their paths that is open there.
        overlap_v: Travel over which paths stay closed.
        bandwidth_hz: Natural frequency of the spool.
        damping: Its damping ratio.
        max_speed_v_s: Limit of its speed.
        delay_s: Transport delay of the command.
        hysteresis_v: Backlash.
    """

    position: Channel | None = None
    command_v: tuple[Finite, Finite] = (0.0, 10.0)
    centre_v: Finite | None = None
    centre: Literal["closed", "exhausted", "pressurised"] = "closed"
    centre_opening: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    overlap_v: NonNegative = 0.0
    bandwidth_hz: Positive | None = None
    damping: Positive = 0.8
    max_speed_v_s: Positive | None = None
    delay_s: NonNegative = 0.0
    hysteresis_v: NonNegative = 0.0

    @property
    def _middle(self) -> float:
        return 0.5 * sum(self.command_v) if self.centre_v is None else self.centre_v

    @model_validator(mode="after")
    def _check(self) -> "_Sliding":
        (low, high), null = self.command_v, self._middle
        if not low < null < high:
            raise ValueError(
                f"command_v: found {low:g} to {high:g} about a centre of {null:g}; the first must"
                " be below the centre and the second above"
            )
        nearest = min(high - null, null - low)
        if self.overlap_v >= nearest:
            raise ValueError(
                f"overlap_v: found {self.overlap_v:g}, it must be below {nearest:g}, where an end"
                " of command_v is"
            )
        if self.centre != "closed" and self.overlap_v == 0.0:
            raise ValueError(
                f"overlap_v: found 0, a centre that is {self.centre} needs the travel over which"
                " its paths close"
            )
        return self

    def _spool(self) -> dict[str, Any]:
        return {
            "null_v": self._middle,
            # a closed centre's overlap is what the general valve knows, finds and disturbs
            "dead_band_v": self.overlap_v if self.centre == "closed" else 0.0,
            "bandwidth_hz": self.bandwidth_hz,
            "damping": self.damping,
            "max_speed_v_s": self.max_speed_v_s,
            "delay_s": self.delay_s,
            "hysteresis_v": self.hysteresis_v,
        }

    def _opens(self, upwards: bool, at_centre: bool) -> dict[str, Any]:
        """Opening curve of a path that is open at one end, and may be at the centre."""
        low, high = self.command_v
        null, overlap, end = self._middle, self.overlap_v, high if upwards else low
        side = 1.0 if upwards else -1.0
        if self.centre == "closed":
            points = [(null, 0.0), (end - side * overlap, 1.0)]
        elif at_centre:
            points = [(null - side * overlap, 0.0), (null, self.centre_opening)]
            if self.centre_opening < 1.0:
                points.append((end, 1.0))
        else:
            points = [(null + side * overlap, 0.0), (end, 1.0)]
        points.sort()
        return {"voltage_v": [v for v, _ in points], "fraction": [f for _, f in points]}

    def _mirrored(self, port: str, upwards: bool, at_centre: bool) -> dict[str, Any]:
        """The curve of a path that is open at the other end than a port's that is alike."""
        (low, high), null = self.command_v, self._middle
        if abs(high - null - (null - low)) < 1e-9:
            return {"mirror": port}
        return self._opens(upwards, at_centre)

    def _general(self, ports: dict[str, Any]) -> dict[str, Any]:
        return {
            "command": self.command,
            "position": self.position,
            "spool": self._spool(),
            "ports": ports,
        }


class FiveThree(_Sliding):
    """A 5/3 valve: one spool between a supply, two outlets and an exhaust or two.

    Towards the upper end of ``command_v`` the first outlet is supplied and the second exhausted,
    towards the lower end the other way round. Its ports are ``supply_a``, ``supply_b``,
    ``exhaust_a`` and ``exhaust_b``. A proportional one (Festo MPYE-5-1/8: 0 to 10 V, 700 l/min,
    about 100 Hz) gives a bandwidth; one with two coils takes -1, 0 and 1 as its command.

    Attributes:
        kind: Says that it is one.
        command: Name of the command it follows.
        supply: Node that it supplies from.
        conductance_m3_s_pa: Sonic conductance of either supply path fully open.
        critical_ratio: Critical pressure ratio of it.
        leakage: Opening fraction that remains of a closed path.
        exhaust_conductance_m3_s_pa: Sonic conductance of either exhaust path; None is as supplied.
        exhaust_critical_ratio: Critical pressure ratio of it; None likewise.
        position: Where the spool's measured position is recorded, in volts of command.
        command_v: Commands at which one path is fully open and the other.
        centre_v: Command of the centre; None is the middle.
        centre: What the outlets meet at the centre: nothing, the exhaust, or the supply.
        centre_opening: Share of the paths to that which is open there.
        overlap_v: Travel from the centre over which closed paths stay closed, and those that are
            open at the centre close.
        bandwidth_hz: Natural frequency of the spool; None follows at once.
        damping: Damping ratio of it.
        max_speed_v_s: Limit of its speed; None is unlimited.
        delay_s: Transport delay of the command.
        hysteresis_v: Backlash, full width.
        outlets: The two outlets.
        exhausts: The exhaust, or that of each outlet.
    """

    kind: Literal["5/3"]
    outlets: tuple[str, str]
    exhausts: Annotated[list[str], Field(min_length=1, max_length=2)]

    def general(self) -> dict[str, Any]:
        """Returns the same valve as the fields of the general one."""
        a, b = self.outlets
        to_room, fed = self.centre == "exhausted", self.centre == "pressurised"
        return self._general(
            {
                "supply_a": self._path(self.supply, a, self._opens(True, fed)),
                "supply_b": self._path(self.supply, b, self._mirrored("supply_a", False, fed)),
                "exhaust_a": self._vent(
                    a, self.exhausts[0], self._mirrored("exhaust_b", False, to_room)
                ),
                "exhaust_b": self._vent(b, self.exhausts[-1], self._opens(True, to_room)),
            }
        )


class ThreeThree(_Sliding):
    """A proportional 3/3 valve, that of the thesis (figs. 3.3 and 5.6): supply, closed, exhaust.

    Towards the upper end of ``command_v`` the outlet is supplied, towards the lower end exhausted.
    Its ports are ``supply`` and ``exhaust``.

    Attributes:
        kind: Says that it is one.
        command: Name of the command it follows.
        supply: Node that it supplies from.
        conductance_m3_s_pa: Sonic conductance of the supply path fully open.
        critical_ratio: Critical pressure ratio of it.
        leakage: Opening fraction that remains of a closed path.
        exhaust_conductance_m3_s_pa: Sonic conductance of the exhaust path; None is as supplied.
        exhaust_critical_ratio: Critical pressure ratio of it; None likewise.
        position: Where the spool's measured position is recorded, in volts of command.
        command_v: Commands at which the exhaust is fully open and the supply is.
        centre_v: Command of the centre; None is the middle.
        centre: What the outlet meets at the centre: nothing, the exhaust, or the supply.
        centre_opening: Share of the path to that which is open there.
        overlap_v: Travel from the centre over which closed paths stay closed, and one that is open
            at the centre closes.
        bandwidth_hz: Natural frequency of the spool; None follows at once.
        damping: Damping ratio of it.
        max_speed_v_s: Limit of its speed; None is unlimited.
        delay_s: Transport delay of the command.
        hysteresis_v: Backlash, full width.
        outlet: The outlet.
        exhaust: The exhaust.
    """

    kind: Literal["3/3"]
    outlet: str
    exhaust: str

    def general(self) -> dict[str, Any]:
        """Returns the same valve as the fields of the general one."""
        to_room, fed = self.centre == "exhausted", self.centre == "pressurised"
        opens = self._opens(True, fed)
        shuts = self._opens(False, to_room)
        if self.centre == "closed":
            shuts = self._mirrored("supply", False, False)
        return self._general(
            {
                "supply": self._path(self.supply, self.outlet, opens),
                "exhaust": self._vent(self.outlet, self.exhaust, shuts),
            }
        )


class _Timed(Part):
    """A valve that is open or closed, but for the time it moves.

    Attributes:
        outlet: The outlet.
        normally: What it is without current.
        opening_delay_s: Delay of opening.
        closing_delay_s: Delay of closing.
        movement_s: Time from one to the other.
        command_v: Commands that switch it off and on.
        threshold_v: Command beyond which it is on.
        pwm_hz: Frequency of a pulse width modulation.
    """

    outlet: str
    normally: Literal["closed", "open"] = "closed"
    opening_delay_s: NonNegative = 0.0015
    closing_delay_s: NonNegative = 0.0015
    movement_s: NonNegative = 0.0005
    command_v: tuple[Finite, Finite] = (0.0, 24.0)
    threshold_v: Finite | None = None
    pwm_hz: Positive | None = None

    @model_validator(mode="after")
    def _switches(self) -> "_Timed":
        off, on = self.command_v
        for name in ("command_v", "threshold_v"):
            if self.pwm_hz is not None and name in self.model_fields_set:
                raise ValueError(
                    f"{name}: found one beside pwm_hz, with which the command is a duty from 0 to"
                    " 1; give one of the two"
                )
        if off == on:
            raise ValueError(f"command_v: found {off:g} for off and for on; they need to differ")
        if self.threshold_v is not None and not min(off, on) < self.threshold_v < max(off, on):
            raise ValueError(
                f"threshold_v: found {self.threshold_v:g}, it must be between the two of command_v,"
                f" {off:g} and {on:g}"
            )
        return self

    def _driven(self) -> dict[str, Any]:
        """The spool and the switch of the general valve, in volts of the command or its duty."""
        off, on = self._levels
        threshold = 0.5 * (off + on) if self.threshold_v is None else self.threshold_v
        speed = abs(on - off) / self.movement_s if self.movement_s > 0.0 else None
        return {
            "spool": {
                "null_v": off if self.normally == "closed" else on,
                "delay_s": self.opening_delay_s,
                "closing_delay_s": self.closing_delay_s,
                "max_speed_v_s": speed,
            },
            "switch": {"off_v": off, "on_v": on, "threshold_v": threshold, "pwm_hz": self.pwm_hz},
        }

    @property
    def _levels(self) -> tuple[float, float]:
        return self.command_v if self.pwm_hz is None else (0.0, 1.0)

    def _opens(self, energised: bool) -> dict[str, Any]:
        """Opening curve of a path that is open with current, or without."""
        off, on = self._levels
        points = sorted([(off, float(not energised)), (on, float(energised))])
        return {"voltage_v": [v for v, _ in points], "fraction": [f for _, f in points]}


class TwoTwo(_Timed, _Kind):
    """A 2/2 on-off valve: open or closed. Its port is ``supply``; it lets gas through either way.

    It follows a switch, or with ``pwm_hz`` the duty of one. A pulse is delayed, and made longer by
    what closing is later than opening, or shorter. One that is shorter than what opening is later
    is swallowed, and so is a gap that is shorter than what closing is later; one shorter than the
    movement opens partly.

    Attributes:
        command: Name of the command it follows.
        supply: Node on one side.
        conductance_m3_s_pa: Sonic conductance open.
        critical_ratio: Critical pressure ratio.
        leakage: Opening fraction that remains closed.
        outlet: Node on the other side.
        normally: What it is without current.
        opening_delay_s: From the switch to where it begins to open. The defaults are those of a
            fast one (Festo MHE2 tells 1.7 and 2 ms to a tenth of the flow; of most others 5 to 30).
        closing_delay_s: From the switch to where it begins to close.
        movement_s: Time from closed to open and back.
        command_v: Commands that switch it off and on.
        threshold_v: Command beyond which it is on; None is between the two.
        pwm_hz: Frequency of a pulse width modulation; the command is then its duty from 0 to 1,
            taken over as a period begins. Periods count from time zero.
        kind: Says that it is one.
    """

    kind: Literal["2/2"]

    def general(self) -> dict[str, Any]:
        """Returns the same valve as the fields of the general one."""
        opens = self._opens(self.normally == "closed")
        ports = {"supply": self._path(self.supply, self.outlet, opens)}
        return {"command": self.command, **self._driven(), "ports": ports}


class ThreeTwo(_Timed, _Venting):
    """A 3/2 on-off valve: the outlet is supplied or exhausted. Its ports are those two.

    It follows a switch, or with ``pwm_hz`` the duty of one, as a 2/2 valve does. Open means that
    the supply is; the exhaust closes as that opens.

    Attributes:
        command: Name of the command it follows.
        supply: Node that it supplies from.
        conductance_m3_s_pa: Sonic conductance of the supply path.
        critical_ratio: Critical pressure ratio of it.
        leakage: Opening fraction that remains of a closed path.
        exhaust_conductance_m3_s_pa: Sonic conductance of the exhaust path; None is as supplied.
        exhaust_critical_ratio: Critical pressure ratio of it; None likewise.
        outlet: The outlet.
        normally: Whether the outlet is exhausted (closed) or supplied (open) without current.
        opening_delay_s: From the switch to where the supply begins to open.
        closing_delay_s: From the switch to where the supply begins to close.
        movement_s: Time from the one to the other.
        command_v: Commands that switch it off and on.
        threshold_v: Command beyond which it is on; None is between the two.
        pwm_hz: Frequency of a pulse width modulation; the command is then its duty from 0 to 1,
            taken over as a period begins. Periods count from time zero.
        kind: Says that it is one.
        exhaust: The exhaust.
    """

    kind: Literal["3/2"]
    exhaust: str

    def general(self) -> dict[str, Any]:
        """Returns the same valve as the fields of the general one."""
        energised = self.normally == "closed"
        ports = {
            "supply": self._path(self.supply, self.outlet, self._opens(energised)),
            "exhaust": self._vent(self.outlet, self.exhaust, self._opens(not energised)),
        }
        return {"command": self.command, **self._driven(), "ports": ports}


class Regulator(_Venting):
    """An electro-pneumatic pressure regulator (SMC ITV, Festo VPPM): a command is a pressure.

    Its own loop measures the pressure at the outlet (the last cell of a pipe, or a chamber) and
    opens the port ``fill`` or ``vent`` in proportion to what is missing beyond a dead zone. Flow
    that is drawn makes the pressure sag until the path is open that far, by ``full_open_pa`` at
    most of what the path can carry. It hunts where the outlet fills, with a path fully open,
    by ``full_open_pa`` within less than about the lags of its spool and its sensor together.

    Attributes:
        command: Name of the command it follows.
        supply: Node that it supplies from.
        conductance_m3_s_pa: Sonic conductance of the fill path fully open.
        critical_ratio: Critical pressure ratio of it.
        leakage: Opening fraction that remains of a closed path (what its pilot consumes).
        exhaust_conductance_m3_s_pa: Sonic conductance of the vent path; None is as supplied.
        exhaust_critical_ratio: Critical pressure ratio of it; None likewise.
        kind: Says that it is one.
        outlet: The outlet, a chamber or the end of a pipe.
        exhaust: The exhaust.
        command_v: Commands of the lowest and the highest pressure; beyond them it stays there.
        low_pa: The lowest pressure.
        high_pa: The highest one (an ITV2030 reaches 500 kPa above the room's).
        dead_zone_pa: Within this of the set-point, either way, nothing opens; None is 0.2 % of the
            range, the sensitivity that an ITV has.
        full_open_pa: By how much more a path is fully open; None is a tenth of the range.
        bandwidth_hz: Bandwidth with which its spool follows, a first-order lag.
        sensor_lag_s: First-order lag of its own pressure sensor.
        integral_s: Time in which a deviation beyond the dead zone opens a path as far once more;
            None has no integral term, and sags under flow.
        delay_s: Transport delay of the command.
        hysteresis_v: Backlash of the set-point, full width (an ITV: 0.5 % of the range).
    """

    kind: Literal["regulator"]
    outlet: str
    exhaust: str
    command_v: tuple[Finite, Finite] = (0.0, 10.0)
    low_pa: Positive = 101325.0
    high_pa: Positive
    dead_zone_pa: NonNegative | None = None
    full_open_pa: Positive | None = None
    bandwidth_hz: Positive = 50.0
    sensor_lag_s: NonNegative = 0.002
    integral_s: Positive | None = None
    delay_s: NonNegative = 0.0
    hysteresis_v: NonNegative = 0.0

    @model_validator(mode="after")
    def _check(self) -> "Regulator":
        low, high = self.command_v
        if not low < high:
            raise ValueError(f"command_v: found {low:g} to {high:g}, it must increase")
        if self.low_pa >= self.high_pa:
            raise ValueError(
                f"high_pa: found {self.high_pa:g}, it must be above low_pa, {self.low_pa:g}"
            )
        return self

    def general(self) -> dict[str, Any]:
        """Returns the same valve as the fields of the general one."""
        span = self.high_pa - self.low_pa
        share = {"voltage_v": list(self.command_v), "fraction": [0.0, 1.0]}
        dead, band = self.dead_zone_pa, self.full_open_pa
        return {
            "command": self.command,
            "spool": {
                "null_v": self.command_v[0],
                "delay_s": self.delay_s,
                "hysteresis_v": self.hysteresis_v,
            },
            "ports": {
                "fill": self._path(self.supply, self.outlet, share),
                "vent": self._vent(self.outlet, self.exhaust, share),
            },
            "regulator": {
                "fill": "fill",
                "vent": "vent",
                "low_pa": self.low_pa,
                "high_pa": self.high_pa,
                "dead_zone_pa": DEAD * span if dead is None else dead,
                "full_open_pa": BAND * span if band is None else band,
                "bandwidth_hz": self.bandwidth_hz,
                "sensor_lag_s": self.sensor_lag_s,
                "integral_s": self.integral_s,
            },
        }


def kind_of_valve(valve: Any) -> str:
    """Which kind the description of a valve says that it is.

    Args:
        valve: A mapping, or a part.
    """
    said = valve.get("kind") if isinstance(valve, dict) else getattr(valve, "kind", None)
    return KINDS[0] if said is None else str(said)


def of_a_kind(valve: Any) -> Any:
    """Refuses a valve of a kind that there is none of.

    Args:
        valve: A mapping, or a part.
    """
    kind = kind_of_valve(valve)
    if kind not in KINDS:
        raise ValueError(f"kind: found {kind!r}, a valve's kind is one of {', '.join(KINDS)}")
    return valve
