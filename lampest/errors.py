"""The one exception that stands for a user's mistake."""


class InputError(ValueError):
    """What the user gave is wrong; the message is one clear sentence. Commands end with exit code 2."""
