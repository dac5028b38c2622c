"""Publication of live frames for other programs. To add a protocol, write its `Publish` here and add it to WAYS."""

from urllib.parse import urlsplit

from lampest.files.errors import InputError
from lampest.report.live.publish.lsl import LslPublish
from lampest.report.live.publish.mqtt import MqttPublish
from lampest.report.live.publish.osc import OscPublish
from lampest.report.live.publish.publish import Publish
from lampest.report.live.publish.websocket import WebsocketPublish

WAYS: tuple[type[Publish], ...] = (LslPublish, OscPublish, MqttPublish, WebsocketPublish)


def publish_at(where: str, token: str | None = None) -> Publish:
    """Parse an address such as `mqtt://localhost:1883/lampest` or `mqtt`. token : required of listeners.

    Raises InputError for an unknown protocol and an invalid address.
    """
    kind, _, address = where.partition("://")
    ways = {way.kind: way for way in WAYS}
    if kind not in ways:
        raise InputError(f"--publish: '{where}' begins with none of {', '.join(ways)}")
    try:
        parts = urlsplit(f"//{address}", allow_fragments=False)
        if parts.query or parts.port == -1:  # `port` raises for an invalid one
            raise ValueError("what follows a question mark means nothing there")
    except ValueError as error:
        raise InputError(f"--publish: '{where}' is no address ({error})") from error
    return ways[kind].at(parts, token)
