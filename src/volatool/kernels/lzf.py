"""LZF decompression, as PCD files of kind ``binary_compressed`` need it."""

from volatool.kernels._jit import kernel


@kernel
def decompress(packed, out):
    """
    Unpack LZF data.

    Parameters
    ----------
    packed : (n,) array of uint8
        Literal runs ``000LLLLL`` and references ``LLLooooo [LLLLLLLL] oooooooo`` into what is
        unpacked already.
    out : (m,) array of uint8
        Set.

    Returns
    -------
    n_out : int
        Bytes unpacked; ``-1 - i`` when the packed byte i can't be followed: it reaches past the
        end of the input or of the output, or before its beginning.
    """
    i = 0
    n_out = 0
    while i < packed.size:
        start = i
        control = int(packed[i])
        i += 1
        if control < 32:
            run = control + 1
            if i + run > packed.size or n_out + run > out.size:
                return -1 - start
            for k in range(run):
                out[n_out + k] = packed[i + k]
            i += run
            n_out += run
            continue
        run = control >> 5
        if i + (2 if run == 7 else 1) > packed.size:
            return -1 - start
        if run == 7:
            run += int(packed[i])
            i += 1
        place = n_out - ((control & 31) << 8) - int(packed[i]) - 1
        i += 1
        run += 2
        if place < 0 or n_out + run > out.size:
            return -1 - start
        for k in range(run):  # byte by byte: a reference may overlap what it writes
            out[n_out + k] = out[place + k]
        n_out += run
    return n_out
