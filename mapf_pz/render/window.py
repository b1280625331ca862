"""A window that shows images and reports pressed keys. Requires pygame-ce: `mapf-pz[render]`."""

from __future__ import annotations

import os
from typing import Any

from mapf_pz.render.rgb import Picture

INVISIBLE = ("dummy", "offscreen")
"""The drivers that SDL falls back to without a display: windows are not visible."""


class Window:
    """A window. The first image opens it, in the size of the image, scaled down if it exceeds the screen."""

    def __init__(self, title: str, fps: float) -> None:
        """Prepare a window; raises `ImportError` if pygame-ce is missing.

        Args:
            title: title of the window.
            fps: maximum number of images per second, which `show` enforces by waiting.
        """
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        try:
            import pygame
        except ImportError as error:
            raise ImportError("a window requires pygame-ce: pip install 'mapf-pz[render]'") from error
        self._pygame: Any = pygame
        self._title, self._fps = title, fps
        self._clock = pygame.time.Clock()
        self._screen: Any = None
        self.is_closed = False

    def show(self, picture: Picture, title: str | None = None) -> None:
        """Show an image (rows, cols, 3); raises `RuntimeError` if there is no screen."""
        pygame = self._pygame
        size = (picture.shape[1], picture.shape[0])
        screen = self._screen = self._screen or self._open(size)
        surface = pygame.surfarray.make_surface(picture.swapaxes(0, 1))
        if size != screen.get_size():
            surface = pygame.transform.smoothscale(surface, screen.get_size())
        screen.blit(surface, (0, 0))
        pygame.display.set_caption(self._title if title is None else f"{self._title}: {title}")
        pygame.display.flip()
        pygame.event.pump()
        self._clock.tick(self._fps)

    def keys(self) -> list[str]:
        """Return the names of the keys pressed since the last call, such as `up`, `space`, `r` or `escape`."""
        names: list[str] = []
        for event in self._pygame.event.get():
            if event.type == self._pygame.QUIT:
                self.is_closed = True
            elif event.type == self._pygame.KEYDOWN:
                names.append(self._pygame.key.name(event.key))
        return names

    def wait(self) -> list[str]:
        """Wait until a key is pressed or the window is closed, and return the result of `keys`."""
        while not (names := self.keys()) and not self.is_closed:
            self._clock.tick(60)
        return names

    def close(self) -> None:
        """Close the window."""
        if self._screen is not None:
            self._pygame.display.quit()
        self._screen, self.is_closed = None, True

    def _require_display(self) -> None:
        """Raise `RuntimeError` if SDL has found no display, unless `SDL_VIDEODRIVER` selects the driver."""
        display = self._pygame.display
        if display.get_driver() in INVISIBLE and not os.environ.get("SDL_VIDEODRIVER"):
            display.quit()
            raise RuntimeError(
                "no window can be opened: there is no display; use render_mode='rgb_array', save the episode with "
                "mapf-pz render, or set SDL_VIDEODRIVER"
            )

    def _open(self, size: tuple[int, int]) -> Any:
        pygame = self._pygame
        try:
            pygame.display.init()
            self._require_display()
            desktop = pygame.display.get_desktop_sizes()[0]
            scale = min(1.0, *(0.92 * available / side for available, side in zip(desktop, size, strict=True)))
            return pygame.display.set_mode([max(1, int(side * scale)) for side in size])
        except pygame.error as error:
            raise RuntimeError(f"no window can be opened: {error}") from None
