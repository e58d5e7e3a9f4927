// SPDX-License-Identifier: Apache-2.0

//: stage
#if defined(__CUDA_ARCH__)
    __shared__ double numbers[WP_TILE_BLOCK_DIM / @CHUNK@][@CHUNK@ * @STRIDE@];
    return reinterpret_cast<wp::uint64>(numbers[threadIdx.x / @CHUNK@]);
#else
    static double numbers[@CHUNK@ * @STRIDE@];
    return reinterpret_cast<wp::uint64>(numbers);
#endif

//: put
    const double* const from = reinterpret_cast<const double*>(&value);
    double* const to = reinterpret_cast<double*>(stage) + lane % @CHUNK@ * @STRIDE@ + @SIZE@ * at;
    for (int i = 0; i < @SIZE@; ++i)
        to[i] = from[i];

//: sum
    const int chunk = lane / @CHUNK@;
    const int* const starts = tables.source_starts.data;
    const int* const sources = tables.sources.data;
    const int first = tables.starts.data[chunk];
    const int end = tables.starts.data[chunk + 1];
    const double* const staged = reinterpret_cast<const double*>(stage);
    double* const to = reinterpret_cast<double*>(sums.data + size_t(env) * sums.shape[1]);
#if defined(__CUDA_ARCH__)
    __syncwarp();
    for (int n = @SIZE@ * first + lane % @CHUNK@; n < @SIZE@ * end; n += @CHUNK@) {
        const int sum = n / @SIZE@;
        const int i = n - @SIZE@ * sum;
        // What counts the other way round is a block, 3x3.
        const int turned = i % 3 * 3 + i / 3;
        double total = 0.0;
        for (int k = starts[sum]; k < starts[sum + 1]; ++k) {
            const int code = sources[k];
            total += staged[(code >> 1) + (code & 1 ? turned : i)];
        }
        to[n] = total;
    }
    __syncwarp();
#else
    if (lane % @CHUNK@ != @CHUNK@ - 1)
        return;
    for (int sum = first; sum < end; ++sum) {
        double total[@SIZE@] = {};
        for (int k = starts[sum]; k < starts[sum + 1]; ++k) {
            const int code = sources[k];
            const double* const from = staged + (code >> 1);
            for (int i = 0; i < @SIZE@; ++i)
                total[i] += from[code & 1 ? i % 3 * 3 + i / 3 : i];
        }
        for (int i = 0; i < @SIZE@; ++i)
            to[@SIZE@ * sum + i] = total[i];
    }
#endif
