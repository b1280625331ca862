"""A window on the screen: shows pictures, and tells which keys were pressed. Needs pygame-ce: `mapf-pz[render]`."""

from __future__ import annotations

import os
from typing import Any

from mapf_pz.render.rgb import Picture

INVISIBLE = ("dummy", "offscreen")
"""The drivers that SDL falls back to where there is no display: windows are drawn, but not shown."""


class Window:
    """One window; the first picture opens it, in its own size or, where that is larger than the screen, smaller."""

    def __init__(self, title: str, fps: float) -> None:
        """Prepare a window; raises `ImportError` where pygame-ce is missing.

        Args:
            title: stands above the pictures.
            fps: the most pictures a second: `show` waits so long.
        """
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        try:
            import pygame
        except ImportError as error:
            raise ImportError("a window needs pygame-ce: pip install 'mapf-pz[render]'") from error
        self._pygame: Any = pygame
        self._title, self._fps = title, fps
        self._clock = pygame.time.Clock()
        self._screen: Any = None
        self.is_closed = False

    def show(self, picture: Picture, title: str | None = None) -> None:
        """Show a picture (rows, cols, 3); raises `RuntimeError` where there is no screen."""
        pygame = self._pygame
        size = (picture.shape[1], picture.shape[0])
        screen = self._screen = self._screen or self._opened(size)
        surface = pygame.surfarray.make_surface(picture.swapaxes(0, 1))
        if size != screen.get_size():
            surface = pygame.transform.smoothscale(surface, screen.get_size())
        screen.blit(surface, (0, 0))
        pygame.display.set_caption(self._title if title is None else f"{self._title}: {title}")
        pygame.display.flip()
        pygame.event.pump()
        self._clock.tick(self._fps)

    def keys(self) -> list[str]:
        """Return the names of the keys that were pressed since the last call: `up`, `space`, `r`, `escape`."""
        names: list[str] = []
        for event in self._pygame.event.get():
            if event.type == self._pygame.QUIT:
                self.is_closed = True
            elif event.type == self._pygame.KEYDOWN:
                names.append(self._pygame.key.name(event.key))
        return names

    def wait(self) -> list[str]:
        """Wait for a key, or until the window is closed, and return what `keys` does."""
        while not (names := self.keys()) and not self.is_closed:
            self._clock.tick(60)
        return names

    def close(self) -> None:
        """Close the window."""
        if self._screen is not None:
            self._pygame.display.quit()
        self._screen, self.is_closed = None, True

    def _require_display(self) -> None:
        """Raise `RuntimeError` where SDL has found no display, unless its driver was chosen by `SDL_VIDEODRIVER`."""
        display = self._pygame.display
        if display.get_driver() in INVISIBLE and not os.environ.get("SDL_VIDEODRIVER"):
            display.quit()
            raise RuntimeError(
                "no window can be opened: there is no display; use render_mode='rgb_array', save the episode with "
                "mapf-pz render, or set SDL_VIDEODRIVER"
            )

    def _opened(self, size: tuple[int, int]) -> Any:
        pygame = self._pygame
        try:
            pygame.display.init()
            self._require_display()
            desktop = pygame.display.get_desktop_sizes()[0]
            share = min(1.0, *(0.92 * room / side for room, side in zip(desktop, size, strict=True)))
            return pygame.display.set_mode([max(1, int(side * share)) for side in size])
        except pygame.error as error:
            raise RuntimeError(f"no window can be opened: {error}") from None
