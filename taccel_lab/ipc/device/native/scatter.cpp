// SPDX-License-Identifier: Apache-2.0

//: add_to_block
// A full warp that adds to one block of one environment adds up first, in a fixed order: most blocks
// of contact are those of the control nodes of a body, and 32 additions to one place take turns.
    double* const entry = reinterpret_cast<double*>(
        values.data + size_t(env) * values.shape[1] + index);
#if defined(__CUDA_ARCH__)
    const unsigned mask = __activemask();
    int together = 0;
    if (mask == 0xffffffffu) {
        const long long place = static_cast<long long>(env) * values.shape[1] + index;
        __match_all_sync(mask, place, &together);
    }
    for (int i = 0; i < 9; ++i) {
        double value = block.data[i / 3][i % 3];
        if (anchor != 0.0)
            value = (value + anchor) - anchor;
        if (together) {
            for (int step = 16; step > 0; step >>= 1)
                value += __shfl_xor_sync(mask, value, step);
            if ((threadIdx.x & 31) == 0)
                atomicAdd(entry + i, value);
        } else
            atomicAdd(entry + i, value);
    }
#else
    for (int i = 0; i < 9; ++i)
        entry[i] += anchor == 0.0 ? block.data[i / 3][i % 3]
                                  : (block.data[i / 3][i % 3] + anchor) - anchor;
#endif
