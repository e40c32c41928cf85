"""How long a batch still takes, from the stages of the fruit that are done."""

import heapq
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass
class _Taken:
    """What a stage took so far: how often, and s together."""

    count: int = 0
    total_s: float = 0.0

    @property
    def mean_s(self) -> float:
        """s, of one."""
        return self.total_s / self.count


class TimeLeft:
    """Each stage takes what it took on average so far; the fruit that wait go to the processes as they become
    free.

    A fruit that ends early says nothing of the stages that it did not finish, so that one refused in a second
    does not make the rest look short. Not known until one fruit has ended; of a stage that none has reached
    nothing can be known.
    """

    def __init__(self, *, total: int, jobs: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.jobs = jobs
        self._waiting = total
        self._clock = clock
        self._running: dict[str, dict[str, float]] = {}
        self._finished: dict[str, _Taken] = {}
        self._broken_off: dict[str, _Taken] = {}
        self._ended = 0

    def stage(self, fruit_id: str, stage: str) -> None:
        """A fruit begins a stage, and the one before it is finished; or says how far it is in its stage
        ("contact: grasp-1, frame 20 of 80"), which is nothing new.
        """
        stage = stage.partition(":")[0]
        if fruit_id not in self._running:
            self._waiting -= 1
        begun = self._running.setdefault(fruit_id, {})
        if stage in begun:
            return
        self._close(begun, self._finished)
        begun[stage] = self._clock()

    def done(self, fruit_id: str, *, whole: bool) -> None:
        """A fruit has ended, after its last stage (`whole`) or in the middle of one."""
        if fruit_id not in self._running:
            self._waiting -= 1
        self._close(self._running.pop(fruit_id, {}), self._finished if whole else self._broken_off)
        self._ended += 1

    def seconds(self) -> float | None:
        """Until the last fruit has ended; None while that is not known."""
        expected = {
            stage: (self._finished.get(stage) or self._broken_off[stage]).mean_s
            for stage in {**self._finished, **self._broken_off}
        }
        if not self._ended or not expected:
            return None
        free = [self._left(begun, expected) for begun in self._running.values()]
        free += [0.0] * (self.jobs - len(free))
        whole_s, waiting = sum(expected.values()), self._waiting
        heapq.heapify(free)
        # No process is busy for longer than a fruit takes, so that every round gives each of them one more.
        rounds = max(0, waiting // len(free) - 1)
        free, waiting = [busy + rounds * whole_s for busy in free], waiting - rounds * len(free)
        for _ in range(waiting):
            heapq.heappush(free, heapq.heappop(free) + whole_s)
        return max(free)

    def _left(self, begun: dict[str, float], expected: dict[str, float]) -> float:
        """Of a fruit that has begun these stages: what the last one still takes, and those not begun."""
        last = next(reversed(begun))
        here = max(0.0, expected.get(last, 0.0) - (self._clock() - begun[last]))
        return here + sum(takes for stage, takes in expected.items() if stage not in begun)

    def _close(self, begun: dict[str, float], taken: dict[str, _Taken]) -> None:
        if begun:
            last = next(reversed(begun))
            one = taken.setdefault(last, _Taken())
            one.count += 1
            one.total_s += self._clock() - begun[last]
