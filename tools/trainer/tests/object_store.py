"""A server of S3 that counts requests."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

Application = Callable[[dict[str, Any], Any], Iterable[bytes]]


def count_requests(server: Any) -> Counter[str]:  # noqa: ANN401
    """The requests that moto's server answers from now on, by their kind."""
    counts: Counter[str] = Counter()
    answer: Application = server._server.app

    def counted(environment: dict[str, Any], start: Any) -> Iterable[bytes]:  # noqa: ANN401
        method = environment["REQUEST_METHOD"]
        is_list = method == "GET" and "list-type" in environment["QUERY_STRING"]
        counts["LIST" if is_list else method] += 1
        return answer(environment, start)

    server._server.app = counted
    return counts
