"""A worker process of the tests: it says what a worker says, has no machine, and does what its machines' names say.

`refuses`: it may not begin. `falls`: it ends before it has begun. `hangs`: it answers twice, and then not any more.
`unheard`: its messages about alarms reach nobody. `mute`: it runs, and once it was begun anew it says nothing any more.
"""

import json
import socket
import sys
import time
from queue import SimpleQueue
from typing import Any

from drivers.supervision import Supervisor
from gateway.plant.channel import SupervisorChannel


def picture() -> dict[str, Any]:
    """What a running, armed machine says of itself, as far as the supervisor looks at it."""
    return {
        "time": 0.0,
        "phase": "running",
        "parts": {},
        "values": {},
        "link": {"alive": True, "connected": True, "reason": ""},
        "scan": {"age": 0.0, "period": 1.0, "late": False},
        "writeback": {"mode": "armed"},
    }


def main() -> None:
    """The same line as a real worker's."""
    requests: SimpleQueue[dict[str, Any]] = SimpleQueue()
    channel = SupervisorChannel(socket.socket(fileno=int(sys.argv[1])), Supervisor(), requests.put)
    begin = channel.ask("begin")
    names = [config["machine"] for config in json.loads(begin["configs"])]
    if "falls" in names:
        sys.exit(3)
    if "refuses" in names:
        channel.ask("refused", problems=["plant.toml: machine 'refuses': no"])
        channel.close()
        return
    channel.ask("open")
    channel.ask("ready")
    answered = 0
    pictures = {name: picture() for name in names if name == "mute"}
    while (message := requests.get())["ask"] != "stop":
        if ("hangs" in names and answered == 2 and not begin["former"]) or ("mute" in names and begin["former"]):
            time.sleep(60.0)
        answered += 1
        status = {"machine": names[0], "answered": answered, "former": begin["former"]}
        unheard = "shift: nobody answers" if "unheard" in names else ""
        silent = {"statuses": pictures, "progress": dict.fromkeys(names, (answered, 0)), "undelivered": unheard}
        content = silent if message["ask"] == "statuses" else {"answer": {"ok": True, "status": status}}
        channel.reply(message["id"], content)
    channel.reply(message["id"], {"statuses": {}})
    channel.close()


if __name__ == "__main__":
    main()
