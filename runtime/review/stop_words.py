"""A stop in words (`stop_document`): in which phase, where on the path, and whether the arm is at rest."""

from collections.abc import Iterator, Mapping
from typing import Any

from cutgate.runtime.review.stopped import APPROACH, RETRACT


def rest_words(stop: Mapping[str, Any]) -> str:
    """Whether the arm stands."""
    if stop["confirmed"]:
        return "yes: the controller's last heartbeat says that it inhibits motion"
    if stop["moving"]:
        return "NO: nobody has confirmed that the arm stands"
    if stop["where"] is None:
        return "no motion was started in this session; the controller has not confirmed the stop"
    return "not confirmed by the controller"


def phase_words(stop: Mapping[str, Any]) -> str:
    """The phase of the session as it was stopped."""
    return str(stop["while"]).replace("_", " ")


def place_words(stop: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The place on the path, and the tip's in the robot frame: label and text."""
    where = stop["where"]
    if where is None:
        yield "where", "not known" if stop["moving"] else "the arm had not been started"
        return
    heard = "" if stop["confirmed"] else ", as last heard"
    if where["leg"] == APPROACH:
        yield "where", f"on the approach, before the cut{heard}"
    elif where["segment"] is None:
        yield "where", "not known: no progress was reported"
    elif where["leg"] == RETRACT:
        yield "where", f"on the retract: the whole path is cut{heard}"
    else:
        done = f"{where['percent']:.1f} % of the path is cut, {where['to_go_mm']:.1f} mm to go"
        yield "where", f"segment {where['segment']} of {where['segments']}: {done}{heard}"
    if where["tip_mm"] is not None:
        x, y, z = where["tip_mm"]
        side = "below" if where["depth_mm"] > 0.0 else "above"
        depth = f"{abs(where['depth_mm']):.1f} mm {side} the entry plane, along the tool"
        yield "tip", f"x {x:.1f} y {y:.1f} z {z:.1f} mm; {depth}{heard}"
