"""SETUP_SIGNING by a client, and storage errors of the signing key."""

from collections.abc import Callable

from autopilot.core import operator_messages as notices
from autopilot.core.clients import Reach
from autopilot.mavlink.context import Context, MavlinkPeer
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.inbox import Address
from autopilot.mavlink.signing import KEY_BYTES
from autopilot.mavlink.wire import Message


class SigningSetup:
    """SETUP_SIGNING (https://mavlink.io/en/guide/message_signing.html)."""

    def __init__(self, ctx: Context, reach: Callable[[Address], Reach]) -> None:
        """``reach``: how far away a client is."""
        self._ctx, self._reach = ctx, reach

    def tick(self) -> None:
        """Advance signing time; report a key that could not be saved."""
        ctx = self._ctx
        ctx.signing.local_may_be_silent = ctx.params["SIGN_LOCAL"] > 0.0
        problem = ctx.signing.tick(ctx.t_us)
        if problem:
            ctx.say(notices.SIGNING_NOT_SAVED(problem=problem))

    def on_setup(self, peer: MavlinkPeer, msg: Message) -> None:
        """SETUP_SIGNING: accepted only from this machine (no eavesdropping) and while disarmed; if a key is in force
        the message has to be signed with it. All zero removes the key.
        """
        ctx = self._ctx
        if self._reach((peer.link, peer.client)) is Reach.NETWORK:
            ctx.say(notices.KEY_FROM_NETWORK(), peer)
        elif ctx.view.armed:
            ctx.say(notices.KEY_WHILE_ARMED(), peer)
        elif ctx.signing.key is not None and not msg.get_msgbuf()[2] & mav.MAVLINK_IFLAG_SIGNED:
            ctx.say(notices.KEY_UNSIGNED(), peer)
        else:
            key = bytes(msg.secret_key)
            none = key == bytes(KEY_BYTES) and msg.initial_timestamp == 0
            if not none and key == bytes(KEY_BYTES):
                ctx.say(notices.KEY_ZERO(), peer)
                return
            ctx.signing.set_key(None if none else key, msg.initial_timestamp)
            ctx.key_changed()
            name = peer.name
            ctx.say(notices.SIGNING_OFF(client=name) if none else notices.SIGNING_ON(client=name))
