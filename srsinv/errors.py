"""What a user can get wrong, said in one sentence."""


class BadInput(ValueError):
    """An input that cannot be used; its text is one sentence naming the value, the bound and the
    remedy. The command line prints that sentence and exits with code 2."""


def refuse(condition: bool, sentence: str) -> None:
    """Raise [`BadInput`][] with `sentence` when `condition` holds.

    Only for concrete values before any computing: a traced value has no truth to test.
    """
    if condition:
        raise BadInput(sentence)
