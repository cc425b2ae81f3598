"""Texts to the operator, which wait until they are taken."""


class Remarks:
    """Base of parts of an estimator that tell something: they append to ``_texts``."""

    def __init__(self) -> None:
        self._texts: list[str] = []

    def take_texts(self) -> tuple[str, ...]:
        """Those since the last call."""
        if not self._texts:
            return ()
        texts, self._texts = tuple(self._texts), []
        return texts
