// SPDX-License-Identifier: Apache-2.0

//: batch
#if defined(__CUDA_ARCH__)
    return 32;
#else
    return 1;
#endif

//: open_queue
#if defined(__CUDA_ARCH__)
    // A warp lays down up to 32 hits on top of 31 that wait.
    __shared__ int hits[4 * WP_TILE_BLOCK_DIM];
    return reinterpret_cast<wp::uint64>(hits + threadIdx.x / 32 * 128);
#else
    static int hits[2];
    return reinterpret_cast<wp::uint64>(hits);
#endif

//: any_lane
#if defined(__CUDA_ARCH__)
    return __any_sync(0xffffffffu, value);
#else
    return value;
#endif

//: put_hit
    int* const hits = reinterpret_cast<int*>(queue);
#if defined(__CUDA_ARCH__)
    // Others may still read what was taken before.
    __syncwarp();
    const unsigned found = __ballot_sync(0xffffffffu, hit >= 0);
    const int at = waiting + __popc(found & ((1u << (threadIdx.x & 31)) - 1u));
    waiting += __popc(found);
#else
    const int at = waiting;
    waiting += hit >= 0;
#endif
    if (hit >= 0) {
        hits[2 * at] = item;
        hits[2 * at + 1] = hit;
    }
#if defined(__CUDA_ARCH__)
    __syncwarp();
#endif
    return waiting;

//: hit_at
#if defined(__CUDA_ARCH__)
    const int at = first + static_cast<int>(threadIdx.x & 31);
#else
    const int at = first;
#endif
    const int* const hits = reinterpret_cast<const int*>(queue);
    if (at >= end)
        return wp::vec_t<2, wp::int32>(-1, -1);
    return wp::vec_t<2, wp::int32>(hits[2 * at], hits[2 * at + 1]);
