"""The page of ``planish explore``: one file for a reader without planish, server or network."""
