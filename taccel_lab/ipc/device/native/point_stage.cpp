// SPDX-License-Identifier: Apache-2.0

//: stage_points
#if defined(__CUDA_ARCH__)
    __shared__ double numbers[WP_TILE_BLOCK_DIM / 32][32 * 85 + 8 * 33];
    return reinterpret_cast<wp::uint64>(numbers[threadIdx.x / 32]);
#else
    static double numbers[32 * 85 + 8 * 33 + 12];
    return reinterpret_cast<wp::uint64>(numbers);
#endif

//: opens_element
#if defined(__CUDA_ARCH__)
    return true;
#else
    return lane % 4 == 0;
#endif

//: keep
#if !defined(__CUDA_ARCH__)
    double* const to = reinterpret_cast<double*>(stage) + 32 * 85 + 8 * 33;
    for (int i = 0; i < 9; ++i)
        to[i] = common.data[i / 3][i % 3];
    for (int i = 0; i < 3; ++i)
        to[9 + i] = volume_part[i];
#endif

//: kept_common
    wp::mat_t<3, 3, wp::float64> common;
#if !defined(__CUDA_ARCH__)
    const double* const from = reinterpret_cast<const double*>(stage) + 32 * 85 + 8 * 33;
    for (int i = 0; i < 9; ++i)
        common.data[i / 3][i % 3] = from[i];
#endif
    return common;

//: kept_volume_part
    wp::vec_t<3, wp::float64> volume_part;
#if !defined(__CUDA_ARCH__)
    const double* const from = reinterpret_cast<const double*>(stage) + 32 * 85 + 8 * 33 + 9;
    for (int i = 0; i < 3; ++i)
        volume_part[i] = from[i];
#endif
    return volume_part;

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
    // In registers: added up in memory, number by number, blocks took five times as long. Eight of
    // the nine numbers of a block go together, and the ninth of all four points.
    typedef double four __attribute__((vector_size(32), aligned(8)));
    typedef double eight __attribute__((vector_size(64), aligned(8)));
    for (int element = 0; element < count; ++element) {
        const double* const e = staged + points + element * element_stride;
        const double* const point = staged + 4 * element * point_stride;
        const auto of_points = [point](int at) {
            return four{point[at], point[at + point_stride], point[at + 2 * point_stride],
                        point[at + 3 * point_stride]};
        };
        four shapes[30];
        for (int i = 0; i < 30; ++i)
            shapes[i] = of_points(54 + i);
        const four last_00 = of_points(8), last_01 = of_points(17), last_02 = of_points(26),
                   last_11 = of_points(35), last_12 = of_points(44), last_22 = of_points(53);
        eight k[4][9];
        for (int q = 0; q < 4; ++q) {
            const auto block = [from = point + q * point_stride](int at) {
                return *reinterpret_cast<const eight*>(from + 9 * at);
            };
            const auto turned = [from = point + q * point_stride](int at) {
                const double* const k = from + 9 * at;
                return eight{k[0], k[3], k[6], k[1], k[4], k[7], k[2], k[5]};
            };
            const eight all[9] = {block(0), turned(1), turned(2), block(1), block(3), turned(4),
                                  block(2), block(4), block(5)};
            for (int i = 0; i < 9; ++i)
                k[q][i] = all[i];
        }
        double* sums = to + 9 * 55 * element;
        for (int a = 0; a < 10; ++a) {
            const four g0 = e[0] * shapes[3 * a];
            const four g1 = e[0] * shapes[3 * a + 1];
            const four g2 = e[0] * shapes[3 * a + 2];
            eight left[4][3];
            for (int q = 0; q < 4; ++q)
                for (int i = 0; i < 3; ++i)
                    left[q][i] = g0[q] * k[q][3 * i] + g1[q] * k[q][3 * i + 1]
                        + g2[q] * k[q][3 * i + 2];
            const four last_0 = g0 * last_00 + g1 * last_01 + g2 * last_02;
            const four last_1 = g0 * last_01 + g1 * last_11 + g2 * last_12;
            const four last_2 = g0 * last_02 + g1 * last_12 + g2 * last_22;
            const double b0 = e[1] * e[2 + 3 * a];
            const double b1 = e[1] * e[3 + 3 * a];
            const double b2 = e[1] * e[4 + 3 * a];
            for (int b = a; b < 10; ++b, sums += 9) {
                const double t0 = e[2 + 3 * b], t1 = e[3 + 3 * b], t2 = e[4 + 3 * b];
                eight total = {b0 * t0, b0 * t1, b0 * t2, b1 * t0,
                               b1 * t1, b1 * t2, b2 * t0, b2 * t1};
                const four s0 = shapes[3 * b], s1 = shapes[3 * b + 1], s2 = shapes[3 * b + 2];
                for (int q = 0; q < 4; ++q)
                    total += s0[q] * left[q][0] + s1[q] * left[q][1] + s2[q] * left[q][2];
                *reinterpret_cast<eight*>(sums) = total;
                const four last = s0 * last_0 + s1 * last_1 + s2 * last_2;
                sums[8] = b2 * t2 + last[0] + last[1] + last[2] + last[3];
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
