import builtins

import numpy as np
import pytest

import mapf_pz
from mapf_pz.render.window import Window

pygame = pytest.importorskip("pygame")


@pytest.fixture
def window():
    opened = Window("title", fps=1000)
    yield opened
    opened.close()


def press(key):
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))


def test_pictures_are_shown_as_they_are(window):
    picture = np.random.default_rng(0).integers(0, 256, (30, 40, 3), np.uint8)
    window.show(picture, "step 3")
    np.testing.assert_array_equal(pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1), picture)
    assert pygame.display.get_caption()[0] == "title: step 3"
    window.show(255 - picture)
    np.testing.assert_array_equal(pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1), 255 - picture)
    assert pygame.display.get_caption()[0] == "title"


def test_a_picture_larger_than_the_screen_is_shown_smaller(window):
    window.show(np.zeros((3000, 6000, 3), np.uint8))
    width, height = pygame.display.get_surface().get_size()
    desktop = pygame.display.get_desktop_sizes()[0]
    assert width <= desktop[0]
    assert height <= desktop[1]
    assert width == pytest.approx(2 * height, abs=2)


def test_keys_and_the_end(window):
    window.show(np.zeros((30, 40, 3), np.uint8))
    window.keys()
    press(pygame.K_UP)
    press(pygame.K_SPACE)
    assert window.keys() == ["up", "space"]
    assert window.keys() == []
    assert not window.is_closed
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    assert window.wait() == []
    assert window.is_closed


def test_without_a_screen_the_error_is_one_line(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "none of that name")
    with pytest.raises(RuntimeError, match="no window can be opened: "):
        Window("title", 4).show(np.zeros((3, 3, 3), np.uint8))


def test_no_display(monkeypatch):
    monkeypatch.delenv("SDL_VIDEODRIVER")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    env = mapf_pz.parallel_env(render_mode="human")
    with pytest.raises(RuntimeError, match=r"^no window can be opened: there is no display; use .*'rgb_array'"):
        env.reset(seed=0)
    monkeypatch.setenv("SDL_VIDEODRIVER", "offscreen")
    env.reset(seed=0)
    env.close()


def test_missing_pygame_names_the_extra(monkeypatch):
    real_import = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "pygame":
            raise ImportError(name)
        return real_import(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ImportError, match=r"mapf-pz\[render\]"):
        Window("title", 4)
