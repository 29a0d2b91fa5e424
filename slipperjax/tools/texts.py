"""Values as texts in errors."""


def brief(value: object) -> str:
    """Return `repr` of a value on one line, cut where it is long; its class where `repr` fails."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # of any class: lists in too many lists, numbers of too many digits, a user's own `repr`
        text = f"<{type(value).__name__}>"
    return text if len(text) <= 80 else f"{text[:77]}..."
