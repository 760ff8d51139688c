"""The command line: parse, call, show. Everything it does is a function of the package."""

from planish.cli.main import main, planish

__all__ = ["main", "planish"]
