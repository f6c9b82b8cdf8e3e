"""Unpacking of LZ4 blocks (github.com/lz4/lz4, doc/lz4_Block_format.md): literals and copies of what came before."""

from vascval.core.jit import njit


@njit
def unpack(packed, target):
    """Unpacks one block into ``target`` (both uint8) and returns the number of bytes, or -1 when it is damaged."""
    n, room = packed.size, target.size
    i, out = 0, 0
    while i < n:
        token = int(packed[i])
        i += 1
        length = token >> 4
        if length == 15:
            while i < n:
                more = int(packed[i])
                i += 1
                length += more
                if more != 255:
                    break
        if i + length > n or out + length > room:
            return -1
        for _ in range(length):
            target[out] = packed[i]
            i += 1
            out += 1
        if i == n:
            return out
        if i + 2 > n:
            return -1
        back = int(packed[i]) | int(packed[i + 1]) << 8
        i += 2
        length = (token & 15) + 4
        if length == 19:
            while i < n:
                more = int(packed[i])
                i += 1
                length += more
                if more != 255:
                    break
        if back == 0 or back > out or out + length > room:
            return -1
        for _ in range(length):
            target[out] = target[out - back]
            out += 1
    return -1
