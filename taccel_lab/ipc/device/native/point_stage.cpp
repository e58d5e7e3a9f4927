// SPDX-License-Identifier: Apache-2.0

//: stage_points
#if defined(__CUDA_ARCH__)
    __shared__ double numbers[WP_TILE_BLOCK_DIM / 32][32 * 85 + 8 * 33];
    return reinterpret_cast<wp::uint64>(numbers[threadIdx.x / 32]);
#else
    static double numbers[32 * 85 + 8 * 33];
    return reinterpret_cast<wp::uint64>(numbers);
#endif

//: put_point
@SIZES@
    const double* const from = reinterpret_cast<const double*>(&h.k_00);
    const double* const rows = reinterpret_cast<const double*>(&shapes);
    double* const to = reinterpret_cast<double*>(stage) + lane % 32 * point_stride;
    for (int i = 0; i < 54; ++i)
        to[i] = from[i];
    for (int i = 0; i < 30; ++i)
        to[54 + i] = rows[i];

//: put_element
@SIZES@
    const double* const rows = reinterpret_cast<const double*>(&slope);
    double* const to =
        reinterpret_cast<double*>(stage) + points + lane % 32 / 4 * element_stride;
    to[0] = weight;
    to[1] = bulk;
    for (int i = 0; i < 30; ++i)
        to[2 + i] = rows[i];

//: write_blocks
@SIZES@
    const double* const staged = reinterpret_cast<const double*>(stage);
    const int first = lane / 32 * 8;
    const int count = first + 8 < blocks.shape[1] ? 8 : static_cast<int>(blocks.shape[1]) - first;
    double* const to = reinterpret_cast<double*>(blocks.data)
        + (static_cast<size_t>(env) * blocks.shape[1] + first) * (9 * 55);
#if defined(__CUDA_ARCH__)
    __syncwarp();
    #pragma unroll 1
    for (int task = lane % 32; task < 55 * count; task += 32) {
        const int element = task / 55;
        int a = 0, b = task - 55 * element;
        while (b >= 10 - a) {
            b -= 10 - a;
            ++a;
        }
        b += a;
        const double* const e = staged + points + element * element_stride;
        double total[9];
        #pragma unroll
        for (int i = 0; i < 9; ++i)
            total[i] = e[1] * e[2 + 3 * a + i / 3] * e[2 + 3 * b + i % 3];
        #pragma unroll 1
        for (int q = 0; q < 4; ++q) {
            const double* const k = staged + (4 * element + q) * point_stride;
            const double* const s = k + 54;
            const double g0 = e[0] * s[3 * a], g1 = e[0] * s[3 * a + 1], g2 = e[0] * s[3 * a + 2];
            const double t0 = s[3 * b], t1 = s[3 * b + 1], t2 = s[3 * b + 2];
            #pragma unroll
            for (int i = 0; i < 9; ++i) {
                const int turned = i % 3 * 3 + i / 3;
                total[i] += t0 * g0 * k[i] + t1 * g1 * k[27 + i] + t2 * g2 * k[45 + i]
                    + t1 * g0 * k[9 + i] + t0 * g1 * k[9 + turned]
                    + t2 * g0 * k[18 + i] + t0 * g2 * k[18 + turned]
                    + t2 * g1 * k[36 + i] + t1 * g2 * k[36 + turned];
            }
        }
        #pragma unroll
        for (int i = 0; i < 9; ++i)
            to[9 * task + i] = total[i];
    }
    __syncwarp();
#else
    if (lane % 32 != 31)
        return;
    for (int element = 0; element < count; ++element) {
        const double* const e = staged + points + element * element_stride;
        double* const sums = to + 9 * 55 * element;
        int pair = 0;
        for (int a = 0; a < 10; ++a)
            for (int b = a; b < 10; ++b, ++pair)
                for (int i = 0; i < 9; ++i)
                    sums[9 * pair + i] = e[1] * e[2 + 3 * a + i / 3] * e[2 + 3 * b + i % 3];
        for (int q = 0; q < 4; ++q) {
            const double* const k = staged + (4 * element + q) * point_stride;
            const double* const s = k + 54;
            pair = 0;
            for (int a = 0; a < 10; ++a) {
                const double g0 = e[0] * s[3 * a];
                const double g1 = e[0] * s[3 * a + 1];
                const double g2 = e[0] * s[3 * a + 2];
                double left[3][9];
                for (int i = 0; i < 9; ++i) {
                    const int turned = i % 3 * 3 + i / 3;
                    left[0][i] = g0 * k[i] + g1 * k[9 + turned] + g2 * k[18 + turned];
                    left[1][i] = g0 * k[9 + i] + g1 * k[27 + i] + g2 * k[36 + turned];
                    left[2][i] = g0 * k[18 + i] + g1 * k[36 + i] + g2 * k[45 + i];
                }
                for (int b = a; b < 10; ++b, ++pair)
                    for (int i = 0; i < 9; ++i)
                        sums[9 * pair + i] += s[3 * b] * left[0][i] + s[3 * b + 1] * left[1][i]
                            + s[3 * b + 2] * left[2][i];
            }
        }
    }
#endif

//: written_elements
#if defined(__CUDA_ARCH__)
    const int first = lane / 4;
    return wp::vec_t<2, wp::int32>(first, lane % 4 == 0 && first < count ? first + 1 : first);
#else
    const int first = lane / 32 * 8;
    const int end = first + 8 < count ? first + 8 : count;
    return wp::vec_t<2, wp::int32>(first, lane % 32 == 31 ? end : first);
#endif

//: sizes
// Odd strides, so that the lanes of a warp write to their own banks.
    const int point_stride = 85;
    const int element_stride = 33;
    const int points = 32 * point_stride;
