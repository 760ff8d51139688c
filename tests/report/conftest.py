"""Pages that the tests of the report read."""

import pytest

from report.runs import a_run, page_of


@pytest.fixture(scope="session")
def link_page():
    return page_of(a_run())


@pytest.fixture(scope="session")
def map_page():
    return page_of(a_run(linked=False))


@pytest.fixture(scope="session")
def bare_page():
    """The page of a map of a sheet without coating."""
    return page_of(a_run(linked=False, coated=False))
