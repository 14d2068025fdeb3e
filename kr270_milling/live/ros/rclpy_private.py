"""Every name of rclpy that is not public, in one file: an update of rclpy concerns this file only.

``package.xml`` has the versions of rclpy with these names: those of ROS 2 Jazzy, 7.1.
"""

from __future__ import annotations

from collections.abc import Iterator

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode
from rclpy.subscription import Subscription

__all__ = ["RCLError", "RMWError", "RobustLifecycleNode", "take_messages"]

RCLError = rclpy_implementation.RCLError
RMWError = rclpy_implementation.RMWError


def take_messages(subscription: Subscription) -> Iterator[tuple[bytes, dict]]:
    """Take the serialised messages that wait in a subscription, each with its arrival and publication times."""
    handle = subscription.handle
    with handle:
        while (taken := handle.take_message(subscription.msg_type, True)) is not None:
            yield taken


class RobustLifecycleNode(LifecycleNode):
    """A lifecycle node that refuses an impossible transition and leaves the graph when it is destroyed."""

    @property
    def state(self) -> str:
        """Name of the lifecycle state."""
        return self._state_machine.current_state[1]

    def destroy_node(self) -> None:
        """Destroy the state machine too: rclpy keeps it, and with it the participant of the node."""
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()

    def _LifecycleNodeMixin__on_change_state(self, request, response):
        """Refuse an impossible transition, for which rclpy raises an error that ends the process."""
        try:
            change = LifecycleNode._LifecycleNodeMixin__on_change_state  # type: ignore[attr-defined]  # noqa: SLF001
            return change(self, request, response)
        except RCLError:
            wanted = request.transition.label or request.transition.id
            self.get_logger().warning(f"transition {wanted} is not possible in state {self.state}")
            response.success = False
            return response
