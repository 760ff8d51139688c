"""The app in the browser, and the page for readers without planish."""
