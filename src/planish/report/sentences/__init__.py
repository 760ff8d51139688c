"""The sentences of the page on statistics: one module a question, joined in ``table``."""
