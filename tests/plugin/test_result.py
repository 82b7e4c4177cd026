"""What a result works out later: once, and without holding on to what it needed for it."""

import weakref
from functools import partial

import pytest

from adagmm_o3d.result import Deferred


class Cloud:
    """Something that can be seen to be gone."""


def test_an_answer_is_worked_out_once_and_lets_go_of_its_clouds():
    asked = []

    def answer(cloud):
        asked.append(type(cloud))
        return len(asked)

    cloud = Cloud()
    kept = weakref.ref(cloud)
    later = Deferred(partial(answer, cloud))
    del cloud
    assert kept() is not None and not asked
    assert later() == later() == 1
    assert kept() is None


def test_an_answer_that_failed_can_be_asked_for_again():
    failing = [True]

    def answer():
        if failing.pop():
            failing.append(False)
            raise MemoryError
        return 7

    later = Deferred(answer)
    with pytest.raises(MemoryError):
        later()
    assert later() == 7
