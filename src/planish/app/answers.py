"""What the page is answered."""

from typing import Any

from starlette.responses import JSONResponse

from planish.core.parameter_words import in_terminal_words


class Answer(JSONResponse):
    """JSON whose texts name parameters as options of the command line."""

    def render(self, content: Any) -> bytes:
        """Write it."""
        return in_terminal_words(super().render(content).decode()).encode()
