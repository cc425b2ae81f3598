"""Slow work beside the loop: counted answers, cancelling, waiting, failures."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from autopilot.core.background import BackgroundWorker, Cancel


@pytest.fixture
def one_thread() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(1) as executor:
        yield executor


def twice(number: int, _: Cancel) -> int:
    return 2 * number


def test_an_answer_comes_once_and_not_before_it_is_due(one_thread: ThreadPoolExecutor) -> None:
    for executor in (None, one_thread):
        task = BackgroundWorker(executor).submit(7, twice, 21)
        assert task.poll(6) is None
        answer = task.poll(7)
        assert answer is not None
        assert answer.get() == 42
        assert task.poll(8) is None


def test_a_patient_desk_waits_and_lets_the_loop_attend_to_what_cannot_wait(one_thread: ThreadPoolExecutor) -> None:
    release = threading.Event()
    worker = BackgroundWorker(one_thread)
    worker.idle = release.set
    task = worker.submit(0, lambda _, cancel: release.wait(60.0), None)
    answer = task.poll(0)
    assert answer is not None
    assert answer.get() is True


def test_in_real_time_the_loop_goes_on_and_a_late_answer_is_counted_once(one_thread: ThreadPoolExecutor) -> None:
    release = threading.Event()
    worker = BackgroundWorker(one_thread, blocking=False)
    task = worker.submit(1, lambda _, cancel: release.wait(60.0), None)
    assert [task.poll(now) for now in range(4)] == [None] * 4
    assert worker.late == 1
    release.set()
    one_thread.submit(lambda: None).result()
    assert task.poll(4) is not None


def test_what_is_cancelled_before_it_begins_is_never_begun(one_thread: ThreadPoolExecutor) -> None:
    release, begun = threading.Event(), []
    worker = BackgroundWorker(one_thread)

    def work(number: int, cancel: Cancel) -> None:
        begun.append(number)
        release.wait(60.0)

    tickets = [worker.submit(0, work, number) for number in range(20)]
    for task in tickets[:-1]:
        task.cancel()
    release.set()
    assert tickets[-1].poll(0) is not None
    assert tickets[0].poll(0) is None
    assert begun[-1] == 19
    assert len(begun) <= 2


def test_work_that_is_under_way_sees_that_it_is_cancelled(one_thread: ThreadPoolExecutor) -> None:
    begun, seen = threading.Event(), threading.Event()

    def work(_: None, cancel: Cancel) -> None:
        begun.set()
        while not cancel.requested:
            pass
        seen.set()

    task = BackgroundWorker(one_thread).submit(0, work, None)
    assert begun.wait(60.0)
    task.cancel()
    assert seen.wait(60.0)


def test_an_exception_of_the_work_is_its_answer(one_thread: ThreadPoolExecutor) -> None:
    def work(_: None, cancel: Cancel) -> int:
        raise ValueError("no way")

    for executor in (None, one_thread):
        answer = BackgroundWorker(executor).submit(0, work, None).poll(0)
        assert answer is not None
        with pytest.raises(ValueError, match="no way"):
            answer.get()
