// SPDX-License-Identifier: Apache-2.0

//: anew
#if defined(__CUDA_ARCH__)
    asm volatile("" : "+r"(value));
#endif
    return value;

//: join_team
// The first block to join closes the team: the highest bit of the count of those who joined.
#if defined(__CUDA_ARCH__)
    __shared__ unsigned int joined[2];
    if (blocks > 1) {
        __syncthreads();
        if (threadIdx.x == 0) {
            unsigned int* gate = reinterpret_cast<unsigned int*>(gates.data) + 32 * env;
            volatile unsigned int* count = gate + 1;
            volatile unsigned int* team = gate + 2;
            const unsigned int closed = 1u << 31;
            const unsigned int rank = atomicAdd(gate + 1, 1u);
            if (rank == 0) {
                const long long start = clock64();
                while (*count < blocks && clock64() - start < patience) {
                }
                *team = atomicOr(gate + 1, closed);
            } else if (rank < closed) {
                while (*team == 0) {
                }
            }
            joined[0] = rank;
            joined[1] = rank < closed ? *team : 0;
        }
        __syncthreads();
        return wp::vec_t<2, wp::int32>(joined[0], joined[1]);
    }
#endif
    return wp::vec_t<2, wp::int32>(0, 1);

//: team_barrier
#if defined(__CUDA_ARCH__)
    __syncthreads();
    if (blocks > 1) {
        if (threadIdx.x == 0) {
@WAIT@
        }
        __syncthreads();
    }
#else
    WP_TILE_SYNC();
#endif

//: team_sum
#if defined(__CUDA_ARCH__)
    __shared__ double parts[2][32][3];
    double a = value[0], b = value[1], c = value[2];
    #pragma unroll
    for (int step = 16; step > 0; step >>= 1) {
        a += __shfl_xor_sync(0xffffffffu, a, step);
        b += __shfl_xor_sync(0xffffffffu, b, step);
        c += __shfl_xor_sync(0xffffffffu, c, step);
    }
    const int warp = threadIdx.x >> 5;
    const int place = threadIdx.x & 31;
    if (place == 0) {
        parts[turn][warp][0] = a;
        parts[turn][warp][1] = b;
        parts[turn][warp][2] = c;
    }
    __syncthreads();
    const int warps = blockDim.x >> 5;
    a = b = c = 0.0;
    #pragma unroll 1
    for (int i = 0; i < warps; ++i) {
        a += parts[turn][i][0];
        b += parts[turn][i][1];
        c += parts[turn][i][2];
    }
    if (blocks > 1) {
        double* slots = reinterpret_cast<double*>(scratch.data) + 3 * blocks * turn;
        if (threadIdx.x == 0) {
            slots[3 * block] = a;
            slots[3 * block + 1] = b;
            slots[3 * block + 2] = c;
@WAIT@
        }
        __syncthreads();
        // Every warp adds up the totals of all blocks, in the same order.
        a = b = c = 0.0;
        for (int i = place; i < blocks; i += 32) {
            a += __ldcg(slots + 3 * i);
            b += __ldcg(slots + 3 * i + 1);
            c += __ldcg(slots + 3 * i + 2);
        }
        #pragma unroll
        for (int step = 16; step > 0; step >>= 1) {
            a += __shfl_xor_sync(0xffffffffu, a, step);
            b += __shfl_xor_sync(0xffffffffu, b, step);
            c += __shfl_xor_sync(0xffffffffu, c, step);
        }
    }
    return wp::vec_t<3, wp::float64>(a, b, c);
#else
    const int lanes = WP_TILE_BLOCK_DIM;
    if (lanes == 1)
        return value;
    wp::vec_t<3, wp::float64>* slots = scratch.data + turn * lanes;
    slots[lane] = value;
    WP_TILE_SYNC();
    wp::vec_t<3, wp::float64> total;
    for (int i = 0; i < lanes; ++i)
        total += slots[i];
    return total;
#endif

//: wait
// One lane of a block waits for those of the other blocks; the count of arrivals only grows. It
// never takes long: stop with an error after seconds, should a block ever be missing.
            unsigned int* gate = reinterpret_cast<unsigned int*>(gates.data) + 32 * env;
            asm volatile("fence.acq_rel.gpu;" ::: "memory");
            const unsigned int arrived = atomicAdd(gate, 1u);
            const unsigned int target = arrived - arrived % blocks + blocks;
            unsigned int polls = 0;
            while (static_cast<int>(*static_cast<volatile unsigned int*>(gate) - target) < 0)
                if (++polls == (1u << 25))
                    __trap();
            asm volatile("fence.acq_rel.gpu;" ::: "memory");
