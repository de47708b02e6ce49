"""A process of its own that takes datagrams from a UDP port at once, and hands them on when they are asked for.

The buffer of a system may hold a quarter of a second of single samples at 1 kHz, and a process that computes may be
kept from its port for longer. This one does nothing else and imports nothing of haptid. `Receiver` runs it as a file:
it prints the port that it has, or why it has none, and then writes messages to its output: length of the content,
address of the sender (4 bytes), its port, content. It ends when its input ends, after what has arrived by then.
"""

from __future__ import annotations

import os
import queue
import signal
import socket
import struct
import sys
import threading

# Before each message: bytes of its content, address and port of the sender.
HEAD = struct.Struct("<I4sH")
# Wanted buffer of the system, bytes; longest content of a datagram; longest wait before the end is looked for, s.
_BUFFER, _LARGEST, _PATIENCE = 1 << 22, 65_507, 0.1
# Messages that may wait: ten minutes of single samples at 1 kHz.
_MOST = 600_000


def _main(address: str, port: str) -> int:
    """Relay until the input ends; 1 if the port cannot be used."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal: the end of the input is what ends this
    receiving = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        receiving.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        receiving.bind((address, int(port)))
    except (OSError, OverflowError) as error:
        print(f"! {getattr(error, 'strerror', None) or error}", flush=True)
        return 1
    print(receiving.getsockname()[1], flush=True)
    waiting: queue.Queue[bytes | None] = queue.Queue(_MOST)
    threading.Thread(target=_receive, args=(receiving, waiting), daemon=True).start()
    try:
        while (message := waiting.get()) is not None:
            sys.stdout.buffer.write(message)
            if waiting.empty():
                sys.stdout.buffer.flush()
        sys.stdout.buffer.flush()
    except BrokenPipeError:  # the parent process has ended
        os._exit(1)
    return 0


def _receive(receiving: socket.socket, waiting: queue.Queue[bytes | None]) -> None:
    """Every message, until the input has ended and nothing more has arrived."""
    over = threading.Event()
    threading.Thread(target=_follow_input, args=(over,), daemon=True).start()
    receiving.settimeout(_PATIENCE)
    while True:
        ended = over.is_set()
        try:
            content, (host, port) = receiving.recvfrom(_LARGEST)
            waiting.put(HEAD.pack(len(content), socket.inet_aton(host), port) + content)
        except TimeoutError:
            if ended:
                break
        except OSError:  # an earlier answer was refused by its receiver: Windows says so here
            continue
    waiting.put(None)


def _follow_input(over: threading.Event) -> None:
    while os.read(sys.stdin.fileno(), 1024):
        pass
    over.set()


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
