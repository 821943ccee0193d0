"""Three sessions, in virtual time: cut to the end, refused, stopped by the operator while cutting."""

from cutgate.runtime.interlock.state import Phase
from tests.runtime.commands.foxglove.sessions import finished_session
from tests.runtime.session.pair import ADMISSIBLE_MM, INADMISSIBLE_MM, job_of, pair_of
from tests.runtime.session.test_stopped import moving


def logs_of(tmp_path_factory):
    """Their log files, by what came of them."""
    found = {}
    for name, given in (("cut", ADMISSIBLE_MM), ("refused", INADMISSIBLE_MM), ("stopped", ADMISSIBLE_MM)):
        folder = tmp_path_factory.mktemp(name)
        with pair_of(folder, *job_of(tmp_path_factory, given)) as pair:
            if name == "stopped":
                assert moving(pair).say("stop").end() is Phase.STOPPED
                found[name] = pair.close().log
            else:
                found[name] = finished_session(pair)
    return found
