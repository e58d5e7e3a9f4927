// SPDX-License-Identifier: Apache-2.0

//: memory
    struct Chunk {
        double numbers[@CHUNK@ * @STRIDE@];
        // Of each sum the end of its sources; 4 (place) + 2 negated + transposed of each source.
        unsigned short ends[@MOST@], sources[@MOST@];
    };

//: stage
#if defined(__CUDA_ARCH__)
@MEMORY@
    __shared__ Chunk chunks[WP_TILE_BLOCK_DIM / @CHUNK@];
    Chunk& mine = chunks[threadIdx.x / @CHUNK@];
    const int chunk = lane / @CHUNK@;
    const int first = tables.starts.data[chunk];
    const int sums = tables.starts.data[chunk + 1] - first;
    const int* const starts = tables.source_starts.data + first;
    const int begin = starts[0];
    const int count = starts[sums] - begin;
    for (int k = lane % @CHUNK@; k < count; k += @CHUNK@)
        mine.sources[k] = static_cast<unsigned short>(tables.sources.data[begin + k]);
    for (int k = lane % @CHUNK@; k < sums; k += @CHUNK@)
        mine.ends[k] = static_cast<unsigned short>(starts[k + 1] - begin);
    return reinterpret_cast<wp::uint64>(&mine);
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
    const int first = tables.starts.data[chunk];
    const int end = tables.starts.data[chunk + 1];
    const double* const staged = reinterpret_cast<const double*>(stage);
    double* const to = reinterpret_cast<double*>(sums.data + size_t(env) * sums.shape[1])
        + @SIZE@ * first;
#if defined(__CUDA_ARCH__)
@MEMORY@
    const Chunk& mine = *reinterpret_cast<const Chunk*>(stage);
    __syncwarp();
    for (int n = lane % @CHUNK@; n < @SIZE@ * (end - first); n += @CHUNK@) {
        const int sum = n / @SIZE@;
        const int i = n - @SIZE@ * sum;
        // What counts the other way round is a block, 3x3.
        const int turned = i % 3 * 3 + i / 3;
        double total = 0.0;
        for (int k = sum > 0 ? mine.ends[sum - 1] : 0; k < mine.ends[sum]; ++k) {
            const int code = mine.sources[k];
            const double part = staged[(code >> 2) + (code & 1 ? turned : i)];
            total += code & 2 ? -part : part;
        }
        to[n] = total;
    }
    __syncwarp();
#else
    if (lane % @CHUNK@ != @CHUNK@ - 1)
        return;
@NINE@
    const int* const starts = tables.source_starts.data + first;
    const int* const sources = tables.sources.data;
    for (int sum = 0; sum < end - first; ++sum) {
        if (@SIZE@ == 9) {
            const double zeros[9] = {};
            Nine total(zeros, false);
            for (int k = starts[sum]; k < starts[sum + 1]; ++k) {
                const Nine part(staged + (sources[k] >> 2), sources[k] & 1);
                if (sources[k] & 2)
                    total.subtract(part);
                else
                    total.add(part);
            }
            total.write(to + 9 * sum);
            continue;
        }
        double total[@SIZE@] = {};
        for (int k = starts[sum]; k < starts[sum + 1]; ++k) {
            const int code = sources[k];
            const double* const from = staged + (code >> 2);
            const double sign = code & 2 ? -1.0 : 1.0;
            for (int i = 0; i < @SIZE@; ++i)
                total[i] += sign * from[code & 1 ? i % 3 * 3 + i / 3 : i];
        }
        for (int i = 0; i < @SIZE@; ++i)
            to[@SIZE@ * sum + i] = total[i];
    }
#endif
