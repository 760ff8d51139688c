"""The browser of the tests of the app, for the search of the site."""

from app.conftest import chromium

__all__ = ["chromium"]
