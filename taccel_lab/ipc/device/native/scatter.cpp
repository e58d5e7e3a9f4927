// SPDX-License-Identifier: Apache-2.0

//: add_to_block
// Threads of a warp that add to one block of one environment add up first, in a fixed order, as
// pairs, pairs of pairs and so on: most blocks of contact are those of the control nodes of a body,
// and 32 additions to one place take turns.
    double* const entry = reinterpret_cast<double*>(
        values.data + size_t(env) * values.shape[1] + index);
#if defined(__CUDA_ARCH__)
    const unsigned active = __activemask();
    const unsigned lane = threadIdx.x & 31u;
    const long long place = static_cast<long long>(env) * values.shape[1] + index;
    const unsigned peers = __match_any_sync(active, place);
    unsigned later = peers & (0xfffffffeu << lane);
    int rank = __popc(peers & ((1u << lane) - 1u));
    int sources[5];
    int rounds = 0;
    #pragma unroll
    for (int r = 0; r < 5; ++r) {
        sources[r] = __ffs(later) - 1;
        rounds += __any_sync(active, later != 0u) ? 1 : 0;
        later &= __ballot_sync(active, (rank & 1) == 0);
        rank >>= 1;
    }
    const bool first = lane == static_cast<unsigned>(__ffs(peers) - 1);
    for (int i = 0; i < 9; ++i) {
        double value = block.data[i / 3][i % 3];
        if (anchor != 0.0)
            value = (value + anchor) - anchor;
        #pragma unroll
        for (int r = 0; r < 5; ++r) {
            if (r < rounds) {
                const double other = __shfl_sync(active, value, max(sources[r], 0));
                if (sources[r] >= 0)
                    value += other;
            }
        }
        if (first)
            atomicAdd(entry + i, value);
    }
#else
    for (int i = 0; i < 9; ++i)
        entry[i] += anchor == 0.0 ? block.data[i / 3][i % 3]
                                  : (block.data[i / 3][i % 3] + anchor) - anchor;
#endif
