// SPDX-License-Identifier: Apache-2.0

//: rows
// Written out in C++: half the time of a solve with arrays of Warp. Four numbers are loaded at a
// time, of which the fourth is never looked at; there always is one more, as the diagonal block
// follows those of a row, and a row those of its columns.
    typedef double four __attribute__((vector_size(32), aligned(8)));
    typedef wp::vec_t<3, wp::float64> three;
    const wp::int32* const starts = row_starts.data;
    const wp::int32* const column = columns.data;
    const double* const blocks = reinterpret_cast<const double*>(values.data);
    const auto dot = [](const three& p, const three& q) {
        return p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
    };
    // Block k times a vector.
    const auto product = [](const double* all, int k, const three& v) {
        const double* const m = all + 9 * k;
        return three(m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
                     m[3] * v[0] + m[4] * v[1] + m[5] * v[2],
                     m[6] * v[0] + m[7] * v[1] + m[8] * v[2]);
    };
    const auto diagonal_product = [=](int i, const three& v) {
        return product(blocks, starts[i + 1] - 1, v);
    };
    // Row i of L times vectors.
    const auto row_product = [=](int i, const three* x) {
        const double* const vectors = reinterpret_cast<const double*>(x);
        const int end = starts[i + 1] - 1;
        const double* a = blocks + 9 * starts[i];
        four row_0 = {}, row_1 = {}, row_2 = {};
        for (int k = starts[i]; k < end; ++k, a += 9) {
            const four u = *reinterpret_cast<const four*>(vectors + 3 * column[k]);
            row_0 += *reinterpret_cast<const four*>(a) * u;
            row_1 += *reinterpret_cast<const four*>(a + 3) * u;
            row_2 += *reinterpret_cast<const four*>(a + 6) * u;
        }
        return three(row_0[0] + row_0[1] + row_0[2], row_1[0] + row_1[1] + row_1[2],
                     row_2[0] + row_2[1] + row_2[2]);
    };
    // y += (row i of L)^T x.
    const auto add_column = [=](int i, const three& x, three* y) {
        double* const vectors = reinterpret_cast<double*>(y);
        const int end = starts[i + 1] - 1;
        const double* a = blocks + 9 * starts[i];
        const four x_0 = {x[0], x[0], x[0], x[0]};
        const four x_1 = {x[1], x[1], x[1], x[1]};
        const four x_2 = {x[2], x[2], x[2], x[2]};
        for (int k = starts[i]; k < end; ++k, a += 9) {
            // Sweeps from the last row to the first outrun what the CPU fetches by itself.
            __builtin_prefetch(a - 9 * 48);
            double* const u = vectors + 3 * column[k];
            const four more = *reinterpret_cast<const four*>(a) * x_0
                + *reinterpret_cast<const four*>(a + 3) * x_1
                + *reinterpret_cast<const four*>(a + 6) * x_2;
            u[0] += more[0];
            u[1] += more[1];
            u[2] += more[2];
        }
    };

//: forward_sweep
@ROWS@
    const double* const inverse = reinterpret_cast<const double*>(inverses.data);
    for (int i = 0; i < b.shape[0]; ++i)
        x.data[i] = product(inverse, i, b.data[i] - row_product(i, x.data));

//: backward_sweep
@ROWS@
    const double* const inverse = reinterpret_cast<const double*>(inverses.data);
    const int n = b.shape[0];
    for (int i = 0; i < n; ++i)
        upper.data[i] = three();
    for (int i = n - 1; i >= 0; --i) {
        const three x_i = product(inverse, i, b.data[i] - upper.data[i]);
        x.data[i] = x_i;
        add_column(i, x_i, upper.data);
    }

//: product_sweep
@ROWS@
    const double* const inverse = reinterpret_cast<const double*>(inverses.data);
    double curvature = 0.0;
    for (int i = 0; i < p.shape[0]; ++i) {
        const three total = keep * p.data[i] + turn * u.data[i] + e.data[i]
            - row_product(i, u.data);
        const three u_i = product(inverse, i, total);
        u.data[i] = u_i;
        curvature += dot(p.data[i], t.data[i] + u_i);
    }
    return curvature;

//: move
@ROWS@
    double rho = 0.0;
    for (int i = 0; i < r.shape[0]; ++i) {
        x.data[i] += way * t.data[i];
        const three r_i = r.data[i] - alpha * (t.data[i] + u.data[i]);
        r.data[i] = r_i;
        const three z = diagonal_product(i, r_i);
        u.data[i] = z;
        rho += dot(r_i, z);
    }
    return rho;

//: residual_sq
@ROWS@
    double total = 0.0;
    for (int i = 0; i < r.shape[0]; ++i) {
        const three row = diagonal_weight * diagonal_product(i, r.data[i])
            + row_product(i, r.data);
        total += dot(row, row);
    }
    return total;

//: subtract_product
@ROWS@
    for (int i = 0; i < x.shape[0]; ++i) {
        const three x_i = x.data[i];
        r.data[i] = r.data[i] - diagonal_product(i, x_i) - row_product(i, x.data);
        add_column(i, -x_i, r.data);
    }
