"""A whole map in one call, as `cutgate reach` makes it with a progress bar for each half."""

from cutgate.runtime.verification.placing.survey import positions, squares, workers_for


def survey(work, grid, cores, done):
    """Squares and positions; ``done`` is told how many positions are judged since the last call."""
    with workers_for(work, cores) as workers:
        return positions(work, workers, grid, squares(work, workers, grid, lambda _: None), done)
