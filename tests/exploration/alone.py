"""The runtime by itself: whatever a controller may say to it comes, and what it names may pass away at any moment.

That is every runtime of every state of the world, and more. One that is past, as nothing that it says counts any more, is
led on nowhere else (``names.is_past``).
"""

from tests.exploration.model import Model
from tests.exploration.names import Passing
from tests.exploration.runtime_side import EVERYTHING
from tests.exploration.world import Move

PASSING = (Passing.EPOCH, Passing.NONCE, Passing.BOOT)


def alone(model: Model) -> tuple[int, list[tuple[int, Move]]]:
    """The number of such runtimes, and what is wrong: from which, by which move."""
    wrong, met = [], {model.runtime.fresh()}
    following = list(met)
    while following:
        run = following.pop()
        changes = model.runtime.changes(run, EVERYTHING)
        wrong += [(run, change.move) for change in changes if change.move.wrong]
        reached = {change.side for change in changes} | {model.real_runtime(run, one) for one in PASSING}
        following += reached - met
        met |= reached
    return len(met), wrong
