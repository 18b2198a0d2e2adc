"""The process that reads the historian for browsers: a line of JSON in, a line out, until its input ends.

Apart from the gateway: what a browser asks for may be years of rows, and no scan waits for the interpreter meanwhile.
"""

import json
import os
import sys
from pathlib import Path

from gateway.outside.web.readings import QUESTIONS
from sim.strict_json import json_text

NICENESS = 10


def main() -> None:
    """Answer until standard input ends, which it does with the gateway. A line begins with + (JSON) or - (a reason)."""
    os.nice(NICENESS)
    path = Path(sys.argv[1])
    for line in sys.stdin.buffer:
        request = json.loads(line)
        try:
            answer = "+" + json_text(QUESTIONS[request["question"]](path, **request["keys"]))
        except (OSError, ValueError) as error:
            answer = "-" + " ".join(str(error).split())
        sys.stdout.buffer.write(answer.encode(errors="replace") + b"\n")
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
