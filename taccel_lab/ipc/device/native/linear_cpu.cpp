// SPDX-License-Identifier: Apache-2.0

//: row_product
// Written out in C++: a quarter less time for a solve than with arrays of Warp. Four numbers are
// loaded at a time, of which the fourth is never looked at; there always is one more, as the
// diagonal block follows those of a row, and a row those of its columns.
    const wp::int32* const column = columns.data;
    const double* a = reinterpret_cast<const double*>(values.data) + 9 * first;
    const double* const vectors = reinterpret_cast<const double*>(x.data);
    typedef double four __attribute__((vector_size(32), aligned(8)));
    four row_0 = {}, row_1 = {}, row_2 = {};
    for (int k = first; k < end; ++k, a += 9) {
        const four u = *reinterpret_cast<const four*>(vectors + 3 * column[k]);
        row_0 += *reinterpret_cast<const four*>(a) * u;
        row_1 += *reinterpret_cast<const four*>(a + 3) * u;
        row_2 += *reinterpret_cast<const four*>(a + 6) * u;
    }
    return wp::vec_t<3, wp::float64>(row_0[0] + row_0[1] + row_0[2], row_1[0] + row_1[1] + row_1[2],
                                     row_2[0] + row_2[1] + row_2[2]);

//: add_column
    const wp::int32* const column = columns.data;
    const double* a = reinterpret_cast<const double*>(values.data) + 9 * first;
    double* const vectors = reinterpret_cast<double*>(y.data);
    typedef double four __attribute__((vector_size(32), aligned(8)));
    const four x_0 = {x[0], x[0], x[0], x[0]};
    const four x_1 = {x[1], x[1], x[1], x[1]};
    const four x_2 = {x[2], x[2], x[2], x[2]};
    for (int k = first; k < end; ++k, a += 9) {
        double* const u = vectors + 3 * column[k];
        const four more = *reinterpret_cast<const four*>(a) * x_0
            + *reinterpret_cast<const four*>(a + 3) * x_1
            + *reinterpret_cast<const four*>(a + 6) * x_2;
        u[0] += more[0];
        u[1] += more[1];
        u[2] += more[2];
    }
