"""How long it usually takes from one fix to the next: a gap begins only beyond that."""

from collections import deque

from autopilot.estimator.estimator_tuning import ENGINE


class FixRhythm:
    """Ages that the newest fix or velocity over ground reaches before the next is used, interval and latency included.

    30 Hz of pictures reach 0.15 s; an acoustic position that comes twice a second reaches more than twice what begins
    a gap among pictures.
    """

    def __init__(self, longest_us: int = ENGINE.longest_rhythm_us) -> None:
        """``longest_us``: no longer age is taken for the usual one."""
        self._longest_us = longest_us
        self._ages_us: deque[int] = deque(maxlen=ENGINE.rhythms_kept)
        self._last_us = 0
        self.alone_after_us = ENGINE.alone_after_us
        self.coast_after_us = ENGINE.coast_after_us

    def note(self, age_us: int) -> None:
        """``age_us``: since the newest fix or velocity over ground that has been used, at every node."""
        if age_us < self._last_us:
            self._ages_us.append(min(self._last_us, self._longest_us))
            usual_us = sorted(self._ages_us)[len(self._ages_us) // 2]
            self.alone_after_us = max(ENGINE.alone_after_us, round(ENGINE.alone_rhythms * usual_us))
            self.coast_after_us = max(ENGINE.coast_after_us, round(ENGINE.coast_rhythms * usual_us))
        self._last_us = age_us
