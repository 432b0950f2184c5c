"""What a user can cause and mend."""


class InputError(Exception):
    """Bad input: the message is one line that names what is wrong and what to do.

    The command line prints the message and exits with status 1; no traceback is shown.
    """

    def __init__(self, message: str):
        # Names from files may hold line breaks.
        super().__init__(" ".join(message.splitlines()))
