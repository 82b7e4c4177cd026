"""When something is logged: once for all, or as one of many pairs."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from adagmm_fusion.rerun_log.entities import EM_STEP, FRAME, ITERATION


@dataclass(frozen=True)
class When:
    """The place of one pair on the timelines.

    A recording of one pair (`frame_index` None) has static data and the timeline `iteration`. A recording of many pairs
    has the timeline `frame`, where each pair shows its result, and `em_step`, which runs through the EM iterations of
    all pairs, one pair after the other.
    """

    frame_index: int | None = None
    em_step: int = 0

    def log(self, rec: rr.RecordingStream, entity: str, *archetypes: Any) -> None:
        """Log what holds for the whole pair."""
        if self.frame_index is None:
            rec.log(entity, *archetypes, static=True)
            return
        rec.set_time(FRAME, sequence=self.frame_index)
        rec.set_time(EM_STEP, sequence=self.em_step)
        rec.log(entity, *archetypes)
        rec.reset_time()

    def log_event(self, rec: rr.RecordingStream, entity: str, iteration: int, *archetypes: Any) -> None:
        """Log what happened in one EM iteration."""
        if self.frame_index is None:
            rec.set_time(ITERATION, sequence=iteration)
        else:
            rec.set_time(FRAME, sequence=self.frame_index)
            rec.set_time(EM_STEP, sequence=self.em_step + iteration)
        rec.log(entity, *archetypes)
        rec.reset_time()

    def clear(self, rec: rr.RecordingStream, entity: str) -> None:
        """This pair has nothing at `entity`: without it the pair before would still show."""
        if self.frame_index is not None:
            self.log(rec, entity, rr.Clear(recursive=True))

    def send_rows(
        self, rec: rr.RecordingStream, entity: str, iterations: np.ndarray, columns_of: Callable[[slice], Any]
    ) -> None:
        """Send one row per EM iteration in one call, and the last one as the pair's result.

        `columns_of(rows)` gives the component columns for a slice of the rows; `iterations` (n,) are their numbers.
        """
        if self.frame_index is None:
            times = [rr.TimeColumn(ITERATION, sequence=iterations)]
        else:
            times = [rr.TimeColumn(EM_STEP, sequence=iterations + self.em_step)]
        rec.send_columns(entity, times, columns_of(slice(None)))
        if self.frame_index is not None:
            rec.send_columns(entity, [rr.TimeColumn(FRAME, sequence=[self.frame_index])], columns_of(slice(-1, None)))
