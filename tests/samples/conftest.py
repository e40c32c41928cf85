"""Scenes that several tests share; drawn, not rendered."""

import pytest

from samples.scenes.draw import Scene, draw_scene


@pytest.fixture(scope="session")
def scenes() -> tuple[Scene, ...]:
    return tuple(draw_scene(k, photos=6) for k in range(64))
