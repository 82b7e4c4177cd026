"""When something is logged: once for all, or as one of many pairs."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from adagmm_fusion.rerun_log.entities import CLOCK, EM_STEP, FRAME, ITERATION, SECONDS

# Time stamps beyond are taken for seconds since 1970, as clocks give them; others count from a start of their own.
EPOCH_SECONDS = 1e8


@dataclass(frozen=True)
class When:
    """The place of one pair on the timelines.

    A recording of one pair (`frame_index` None) has static data and the timeline `iteration`. A recording of many pairs
    has the timeline `frame`, where each pair shows its result, and `em_step`, which runs through the EM iterations of
    all pairs, one pair after the other; with a `timestamp` [s] also "recorded at", or "recorded after" where it is none
    of a clock.
    """

    frame_index: int | None = None
    em_step: int = 0
    timestamp: float | None = None

    def log(self, rec: rr.RecordingStream, entity: str, *archetypes: Any) -> None:
        """Log what holds for the whole pair."""
        if self.frame_index is None:
            rec.log(entity, *archetypes, static=True)
            return
        self._set_times(rec, self.em_step)
        rec.log(entity, *archetypes)
        rec.reset_time()

    def log_event(self, rec: rr.RecordingStream, entity: str, iteration: int, *archetypes: Any) -> None:
        """Log what happened in one EM iteration."""
        if self.frame_index is None:
            rec.set_time(ITERATION, sequence=iteration)
        else:
            self._set_times(rec, self.em_step + iteration)
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
            result = [rr.TimeColumn(FRAME, sequence=[self.frame_index])]
            if self.timestamp is not None and abs(self.timestamp) > EPOCH_SECONDS:
                result.append(rr.TimeColumn(CLOCK, timestamp=[self.timestamp]))
            elif self.timestamp is not None:
                result.append(rr.TimeColumn(SECONDS, duration=[self.timestamp]))
            rec.send_columns(entity, result, columns_of(slice(-1, None)))

    def _set_times(self, rec: rr.RecordingStream, em_step: int) -> None:
        rec.set_time(FRAME, sequence=self.frame_index)
        rec.set_time(EM_STEP, sequence=em_step)
        if self.timestamp is not None and abs(self.timestamp) > EPOCH_SECONDS:
            rec.set_time(CLOCK, timestamp=self.timestamp)
        elif self.timestamp is not None:
            rec.set_time(SECONDS, duration=self.timestamp)
