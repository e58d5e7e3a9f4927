// SPDX-License-Identifier: Apache-2.0

//: pixel
    const int pixel = (i < count ? i : count - 1) % pixel_count;
    const wp::vec_t<3, wp::float32> s = samples.data[i < count ? i : count - 1];
    const wp::vec_t<3, wp::float32> r = rest.data[pixel];
    // How far the pixel is from rest: in levels, to first order, or (without a limit) at all.
    wp::vec_t<3, wp::float32> weight(1.0f, 1.0f, 1.0f);
    if (still_levels > 0.0f) weight = sensitivity.data[pixel];
    const float away = fabsf(s[0] - r[0]) * weight[0] + fabsf(s[1] - r[1]) * weight[1]
        + fabsf(s[2] - r[2]) * weight[2];
    // False too where either surface is missing, which is NaN.
    const bool moved = i < count && (away > still_levels || ((mode & 4) && away >= 0.0f));
    float sx = moved ? s[0] : 0.0f;
    float sy = moved ? s[1] : 0.0f;
    // Slopes beyond the cone are turned back to it.
    const float steep = sqrtf(sx * sx + sy * sy);
    if (steep > norm[14]) {
        sx *= norm[14] / steep;
        sy *= norm[14] / steep;
    }
#if defined(__CUDA_ARCH__)
    const float inverse = rsqrtf(1.0f + sx * sx + sy * sy);
#else
    const float inverse = 1.0f / sqrtf(1.0f + sx * sx + sy * sy);
#endif
    float x[8];
    x[0] = norm[12] * (pixel % width) - 1.0f;
    x[1] = norm[13] * (pixel / width) - 1.0f;
    x[2] = -sx * inverse;
    x[3] = -sy * inverse;
    x[4] = inverse;
    x[5] = moved ? 1e3f * (s[2] - r[2]) : 0.0f;
    x[6] = 0.0f;
    x[7] = 0.0f;
    #pragma unroll
    for (int k = 0; k < 6; ++k)
        x[k] = (x[k] - norm[k]) * norm[6 + k];
    float out[3] = {0.0f, 0.0f, 0.0f};

//: finish
    if (i >= count) return;
    const wp::vec_t<3, wp::float32> at_rest = anchor.data[pixel];
    const wp::vec_t<3, wp::float32> base = background.data[pixel];
    for (int c = 0; c < 3; ++c) {
        float level = base[c] + (moved ? out[c] - at_rest[c] : 0.0f);
        level = level > 0.0f ? (level < 255.0f ? level : 255.0f) : 0.0f;
        if (mode & 1) image.data[3 * i + c] = (unsigned char)(rintf(level));
        if (mode & 2) levels.data[3 * i + c] = level;
        if (mode & 4) levels.data[3 * i + c] = out[c];
    }

//: host_place
    {
        const float* across = place.data + @STRIDE@ * (pixel % width);
        const float* down = place.data + @STRIDE@ * (width + pixel / width);
        for (int o = 0; o < @OUT@; ++o) b[o] += across[o] + down[o];
    }

//: cuda_begin
    const int lane = i & 31;
    const unsigned all = 0xffffffffu;
    if (__any_sync(all, moved)) {
    auto act = [](float x) { @ACTIVATION@ };
    auto pack = [](float low, float high) {
        unsigned d;
        asm("cvt.rn.f16x2.f32 %0, %1, %2;" : "=r"(d) : "f"(high), "f"(low));
        return d;
    };
    auto unpack = [](unsigned d, float& low, float& high) {
        asm("{.reg .f16 l, h; mov.b32 {l, h}, %2; cvt.f32.f16 %0, l; cvt.f32.f16 %1, h;}"
            : "=f"(low), "=f"(high) : "r"(d));
    };
    // d = a b + c, where c may be d.
    auto mma16 = [](float* d, const unsigned* a, unsigned b0, unsigned b1, const float* c) {
        asm("mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 "
            "{%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%10, %11, %12, %13};"
            : "=f"(d[0]), "=f"(d[1]), "=f"(d[2]), "=f"(d[3])
            : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b0), "r"(b1),
              "f"(c[0]), "f"(c[1]), "f"(c[2]), "f"(c[3]));
    };
    auto mma8 = [](float* d, const unsigned* a, unsigned b0, const float* c) {
        asm("mma.sync.aligned.m16n8k8.row.col.f32.f16.f16.f32 "
            "{%0, %1, %2, %3}, {%4, %5}, {%6}, {%7, %8, %9, %10};"
            : "=f"(d[0]), "=f"(d[1]), "=f"(d[2]), "=f"(d[3])
            : "r"(a[0]), "r"(a[1]), "r"(b0), "f"(c[0]), "f"(c[1]), "f"(c[2]), "f"(c[3]));
    };
    // Each lane splits its pixel's inputs, then fetches those two of them of four pixels that its
    // place in operand A asks for: rows g and g + 8, first as high halves, then as low ones.
    unsigned a0[2][4];
    {
        unsigned high[4], low[4];
        #pragma unroll
        for (int k = 0; k < 4; ++k) {
            high[k] = pack(x[2 * k], x[2 * k + 1]);
            float h0, h1;
            unpack(high[k], h0, h1);
            low[k] = pack(x[2 * k] - h0, x[2 * k + 1] - h1);
        }
        const int t = lane & 3;
        #pragma unroll
        for (int m = 0; m < 2; ++m)
            #pragma unroll
            for (int half = 0; half < 2; ++half) {
                const int from = 16 * m + 8 * half + (lane >> 2);
                unsigned h = 0, l = 0;
                #pragma unroll
                for (int k = 0; k < 3; ++k) {
                    const unsigned hk = __shfl_sync(all, high[k], from);
                    const unsigned lk = __shfl_sync(all, low[k], from);
                    h = t == k ? hk : h;
                    l = t == k ? lk : l;
                }
                a0[m][half] = h;
                a0[m][half + 2] = l;
            }
    }
    const int column = 2 * (lane & 3);

//: cuda_accumulators
        float c[2][2][4], b[2][4];
        #pragma unroll
        for (int n = 0; n < 2; ++n) {
            const float2 two =
                __ldg((const float2*)(biases.data + @BIAS@ + 16 * p + 8 * n + column));
            b[n][0] = two.x; b[n][1] = two.y; b[n][2] = two.x; b[n][3] = two.y;
        }

//: cuda_place
    // Rows of the table for the four pixels whose sums this lane holds: g and g + 8 of operand A.
    const float* across[2][2];
    const float* down[2][2];
    #pragma unroll
    for (int m = 0; m < 2; ++m)
        #pragma unroll
        for (int half = 0; half < 2; ++half) {
            const int at = __shfl_sync(all, pixel, 16 * m + 8 * half + (lane >> 2));
            across[m][half] = place.data + @STRIDE@ * (at % width) + column;
            down[m][half] = place.data + @STRIDE@ * (width + at / width) + column;
        }

//: cuda_place_sums
        #pragma unroll
        for (int m = 0; m < 2; ++m)
            #pragma unroll
            for (int n = 0; n < 2; ++n)
                #pragma unroll
                for (int half = 0; half < 2; ++half) {
                    const float2 x = __ldg((const float2*)(across[m][half] + 16 * p + 8 * n));
                    const float2 y = __ldg((const float2*)(down[m][half] + 16 * p + 8 * n));
                    c[m][n][2 * half] = b[n][2 * half] + @SCALE@ * (x.x + y.x);
                    c[m][n][2 * half + 1] = b[n][2 * half + 1] + @SCALE@ * (x.y + y.y);
                }

//: cuda_activate
        #pragma unroll
        for (int m = 0; m < 2; ++m)
            #pragma unroll
            for (int n = 0; n < 2; ++n) {
                a@NEXT@[m][p][2 * n] = pack(act(c[m][n][0]), act(c[m][n][1]));
                a@NEXT@[m][p][2 * n + 1] = pack(act(c[m][n][2]), act(c[m][n][3]));
            }

//: cuda_first
    unsigned a1[2][@OUT@][4];
@PLACE@
    #pragma unroll
    for (int p = 0; p < @OUT@; ++p) {
@ACCUMULATORS@
@PLACE_SUMS@
        const uint4 w = __ldg((const uint4*)(fragments.data + @START@) + p * 32 + lane);
        #pragma unroll
        for (int m = 0; m < 2; ++m) {
            // x = hi + lo meets the weights' high half, hi their low half.
            mma16(c[m][0], a0[m], w.x, w.x, @SUM0@);
            mma16(c[m][1], a0[m], w.z, w.z, @SUM1@);
            mma8(c[m][0], a0[m], w.y, c[m][0]);
            mma8(c[m][1], a0[m], w.w, c[m][1]);
        }
@ACTIVATE@
    }

//: cuda_hidden
    unsigned a@NEXT@[2][@OUT@][4];
    #pragma unroll
    for (int p = 0; p < @OUT@; ++p) {
@ACCUMULATORS@
        #pragma unroll
        for (int k = 0; k < @IN@; ++k) {
            const uint4 w = __ldg(
                (const uint4*)(fragments.data + @START@) + (p * @IN@ + k) * 32 + lane);
            #pragma unroll
            for (int m = 0; m < 2; ++m) {
                mma16(c[m][0], a@LAYER@[m][k], w.x, w.y, k == 0 ? b[0] : c[m][0]);
                mma16(c[m][1], a@LAYER@[m][k], w.z, w.w, k == 0 ? b[1] : c[m][1]);
            }
        }
@ACTIVATE@
    }

//: cuda_end
    float c[2][4] = {{0.0f, 0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f, 0.0f}};
    #pragma unroll
    for (int k = 0; k < @IN@; ++k) {
        const uint2 w = __ldg((const uint2*)(fragments.data + @START@) + k * 32 + lane);
        mma16(c[0], a@LAYER@[0][k], w.x, w.y, c[0]);
        mma16(c[1], a@LAYER@[1][k], w.x, w.y, c[1]);
    }
    // Row g of the result lies in lanes 4 g and 4 g + 1, row g + 8 in their upper registers.
    const int from = 4 * (lane & 7);
    #pragma unroll
    for (int m = 0; m < 2; ++m)
        #pragma unroll
        for (int half = 0; half < 2; ++half) {
            const float red = __shfl_sync(all, c[m][2 * half], from);
            const float green = __shfl_sync(all, c[m][2 * half + 1], from);
            const float blue = __shfl_sync(all, c[m][2 * half], from + 1);
            if ((lane >> 3) == 2 * m + half) { out[0] = red; out[1] = green; out[2] = blue; }
        }
    }
