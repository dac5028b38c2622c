"""Who may see the page: whoever brings the token that lampest printed, or the cookie that was given for it."""

import re
import secrets
from dataclasses import dataclass, field
from hmac import compare_digest
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlsplit

from lampest.files.errors import InputError

FEWEST_SIGNS = 16


@dataclass(frozen=True)
class Access:
    """A token and the cookie for it; without a token everybody may see the page.

    token : at least 16 letters, digits or any of - _ . ~, or ''. name : of the cookie. Raises InputError for another.
    """

    token: str = ""
    name: str = "lampest"
    secret: str = field(default_factory=lambda: secrets.token_urlsafe(24))

    def __post_init__(self) -> None:
        if self.token and not re.fullmatch(rf"[A-Za-z0-9._~-]{{{FEWEST_SIGNS},}}", self.token):
            raise InputError(
                f"--token: give at least {FEWEST_SIGNS} letters, digits or any of - _ . ~ (or none: one is made up)"
            )

    @classmethod
    def of(cls, token: str | None, local: bool, port: int) -> "Access":
        """With the given token; without one, nobody but this computer comes in without a token that is made up here."""
        return cls(token or ("" if local else secrets.token_urlsafe(24)), f"lampest-{port}")

    def shown_by(self, target: str, authorization: str) -> bool:
        """Whether the address asked for, or the header Authorization, has the token."""
        brought = [value for name, value in query(target) if name == "token"]
        brought += [
            authorization.removeprefix(kind) for kind in ("Bearer ", "token ") if authorization.startswith(kind)
        ]
        return bool(self.token) and any(same(text, self.token) for text in brought)

    def remembered_by(self, cookie: str) -> bool:
        """Whether the header Cookie has what was given for the token."""
        try:
            found = SimpleCookie(cookie).get(self.name)
        except CookieError:
            return False
        return found is not None and same(found.value, self.secret)

    @property
    def cookie(self) -> str:
        """What the browser is to remember, for this server alone and hidden from scripts."""
        return f"{self.name}={self.secret}; HttpOnly; SameSite=Lax; Path=/"


def same(one: str, other: str) -> bool:
    """Whether two texts are equal, in a time that does not tell where they differ."""
    return compare_digest(one.encode("utf-8", "surrogatepass"), other.encode("utf-8", "surrogatepass"))


def query(target: str) -> list[tuple[str, str]]:
    """The (name, value) pairs behind the question mark of what a request asks for."""
    try:
        return parse_qsl(urlsplit(target).query, keep_blank_values=True, max_num_fields=8)
    except ValueError:
        return [("", "")]
