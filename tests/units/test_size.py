"""Measures of `python -m tests.size`."""

from tests.size import python_size

DOCUMENTED = '''"""A docstring
of two lines."""

# a comment
def area(width, height):
    """Return the area."""
    return (
        width * height
    )
'''


def test_tokens_and_lines_leave_out_comments_docstrings_and_layout() -> None:
    size = python_size(DOCUMENTED)
    # def area ( width , height ) : return ( width * height )
    assert size["tokens"] == 14
    assert size["lines"] == 4
    assert size["long functions"] == size["long modules"] == 0


def test_functions_over_60_lines_and_modules_over_600_are_counted() -> None:
    def function_of(lines: int) -> str:
        return "def long():\n" + "    pass\n" * (lines - 1)

    assert python_size(function_of(60))["long functions"] == 0
    assert python_size(function_of(61))["long functions"] == 1
    assert python_size("pass\n" * 600)["long modules"] == 0
    assert python_size("pass\n" * 601)["long modules"] == 1
