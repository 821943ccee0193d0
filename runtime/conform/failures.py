"""Why a case does not pass, or the suite does not go on."""


class DeviationError(Exception):
    """The controller did something else than it must; the text says what came."""


class InconclusiveError(Exception):
    """The case could not be judged; the text says why."""


class HaltError(Exception):
    """The suite must not go on: something moved, the enabling device is pressed, or the controller is gone."""


class OperatorError(HaltError):
    """The suite must not go on because the operator has not kept to what was asked."""
