"""Which effects of the linear round are refitted with full models, against what, and in what order."""

from types import SimpleNamespace

import pytest

from fem.mismatch.selection import model_selection
from fem.mismatch.selection.model_selection import refitted_singles


def single(name: str, gain: float, *, always: bool = False) -> model_selection._Candidate:
    spec = SimpleNamespace(name=name, always_refitted=always)
    return model_selection._Candidate(name, gain, (SimpleNamespace(effect=SimpleNamespace(spec=spec)),))  # type: ignore[arg-type]


@pytest.fixture
def refitted(monkeypatch):
    """Of each effect that was refitted, what it was held against; each gains as the linear round says."""
    held_against: dict[str, float] = {}

    def refit_one(_forward, _linear, one, *, best):
        held_against[one.name] = best
        return model_selection._Candidate(one.name, one.gain, one.linear_fits, refit=object())  # type: ignore[arg-type]

    monkeypatch.setattr(model_selection, "_refitted", refit_one)
    return held_against


def tried(*found: model_selection._Candidate, workers: int = 1) -> list[str]:
    """Names, best first."""
    forward = SimpleNamespace(workers=workers)
    return [one.name for one in refitted_singles(forward, None, found)]  # type: ignore[arg-type]


@pytest.mark.parametrize("workers", [1, 2])
def test_threads_change_neither_what_is_refitted_nor_what_it_is_held_against(refitted, workers):
    found = [single("skin", 20.0), single("damage", 30.0), single("slip", 18.0), single("creep", 17.0)]
    assert tried(*found, workers=workers) == ["damage", "skin", "slip", "creep"]
    assert refitted == {"skin": 0.0, "damage": 20.0, "slip": 20.0, "creep": 30.0}


def test_what_gains_little_is_left_and_a_pit_of_another_size_is_refitted_all_the_same(refitted):
    found = [single("skin", 50.0), single("slip", 0.1 * 50.0), single("pit_size", 1.0, always=True)]
    assert tried(*found) == ["skin", "slip", "pit_size"]
    assert refitted == {"skin": 0.0, "pit_size": 50.0}


def test_one_that_is_refitted_alone_has_all_threads(refitted, monkeypatch):
    at_once: list[int] = []
    several = model_selection.parallel_map

    def counted(call, items, **options):
        at_once.append(len(items))
        return several(call, items, **options)

    monkeypatch.setattr(model_selection, "parallel_map", counted)
    found = [single("skin", 50.0), single("slip", 0.1 * 50.0), single("pit_size", 1.0, always=True)]
    tried(*found, workers=4)
    assert at_once == [1, 1]
