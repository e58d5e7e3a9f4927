// SPDX-License-Identifier: Apache-2.0

//: warp_sum
#if defined(__CUDA_ARCH__)
    wp::mat_t<3, 3, wp::float64> total = value;
    for (int i = 0; i < 9; ++i)
        for (int step = 16; step > 0; step >>= 1)
            total.data[i / 3][i % 3] +=
                __shfl_xor_sync(0xffffffffu, total.data[i / 3][i % 3], step);
    return total;
#else
    return value;
#endif

//: restrict
// One warp a chunk, and a row of A_c^-1; the CPU, whose lanes know nothing of each other, one lane.
    const wp::vec_t<3, wp::int32>* const chunk = chunks.data;
    double* const to = loads.data;
#if defined(__CUDA_ARCH__)
    const int place = lane % 32;
    for (int c = first + lane / 32; c < end; c += lanes / 32) {
        double sums[6] = {};
        #pragma unroll 2
        for (int k = place; k < chunk[c][1]; k += 32) {
            const wp::vec_t<3, wp::float64> u = w.data[chunk[c][0] + k];
            const wp::vec_t<3, wp::float64> x = points.data[chunk[c][0] + k];
            const wp::vec_t<3, wp::float64> turn = wp::cross(x, u);
            #pragma unroll
            for (int i = 0; i < 3; ++i) {
                sums[i] += u[i];
                sums[3 + i] += turn[i];
            }
        }
        #pragma unroll
        for (int i = 0; i < 6; ++i) {
            #pragma unroll
            for (int step = 16; step > 0; step >>= 1)
                sums[i] += __shfl_xor_sync(0xffffffffu, sums[i], step);
            if (place == i)
                to[6 * c + i] = sums[i];
        }
    }
#else
    for (int c = first + lane; c < end; c += lanes) {
        wp::vec_t<3, wp::float64> shift, turn;
        for (int k = chunk[c][0]; k < chunk[c][0] + chunk[c][1]; ++k) {
            shift += w.data[k];
            turn += wp::cross(points.data[k], w.data[k]);
        }
        for (int i = 0; i < 3; ++i) {
            to[6 * c + i] = shift[i];
            to[6 * c + 3 + i] = turn[i];
        }
    }
#endif

//: move_parts
// A_c^-1 is symmetric: lanes side by side take rows side by side, and read a column of it. Several
// lanes share a row.
    const wp::vec_t<2, wp::int32>* const span = spans.data;
    const double* const inverse = inverses.data;
    double share = 0.0;
#if defined(__CUDA_ARCH__)
    __shared__ double own[@WIDTH@], sums[@LANES@], moved[@WIDTH@];
    for (int k = lane; k < width; k += lanes) {
        const int begin = k == lane ? ahead[0] : span[k / 6][0];
        const int behind = k == lane ? ahead[1] : span[k / 6][1];
        double total = 0.0;
        #pragma unroll 2
        for (int c = begin; c < behind; ++c)
            total += loads.data[6 * c + k % 6];
        own[k] = total;
    }
    __syncthreads();
    const int rows = end - first;
    const int sharing = rows < lanes ? lanes / rows : 1;
    for (int t = lane; t < rows * sharing; t += lanes) {
        const double* const column = inverse + first + t % rows;
        double total = 0.0;
        #pragma unroll 8
        for (int k = t / rows; k < width; k += sharing)
            total += column[width * k] * own[k];
        sums[t] = total;
    }
    __syncthreads();
    for (int row = lane; row < rows; row += lanes) {
        double total = 0.0;
        for (int t = row; t < rows * sharing; t += rows)
            total += sums[t];
        moved[row] = total;
    }
    __syncthreads();
#else
    double* const moved = motions.data + first;
    WP_TILE_SYNC();
    for (int row = first + lane; row < end; row += lanes) {
        double total = 0.0;
        for (int k = 0; k < width; ++k)
            for (int c = span[k / 6][0]; c < span[k / 6][1]; ++c)
                total += inverse[width * k + row] * loads.data[6 * c + k % 6];
        moved[row - first] = total;
    }
    WP_TILE_SYNC();
#endif
    for (int place = from_place + lane; place < to_place; place += lanes) {
        const double* const motion = moved + 6 * parts.data[place] - first;
        const wp::vec_t<3, wp::float64> shift(motion[0], motion[1], motion[2]);
        const wp::vec_t<3, wp::float64> turn(motion[3], motion[4], motion[5]);
        const wp::vec_t<3, wp::float64> more = shift + wp::cross(turn, points.data[place]);
        share += wp::dot(w.data[place], more);
        m.data[place] += more;
    }
    return share;
