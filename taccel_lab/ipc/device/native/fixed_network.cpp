// SPDX-License-Identifier: Apache-2.0

//: begin
    // A warp takes 32 rows through all layers of one member, whose numbers lie in shared memory:
    // each lane sums 8 rows of some outputs. Weights come there for all warps, a part at a time.
    const float* own = weights.data + static_cast<wp::uint64>(member) * weights.shape[1];
    const int rows = inputs.shape[1];
    if (32 * @WARPS@ * block >= counted.data[0]) return;
    auto act = [](float x) {
#if defined(__CUDA_ARCH__)
        return __fdividef(x, 1.0f + __expf(-x));
#else
        return x / (1.0f + expf(-x));
#endif
    };
#if defined(__CUDA_ARCH__)
    __shared__ __align__(16) float part[@PART@ * @MOST@];
    __shared__ __align__(16) float kept[@WARPS@][@KEPT@ * 32];
    const int lane = thread % 32, eight = 8 * (lane / 8), group = lane % 8;
    const int row = 32 * (@WARPS@ * block + thread / 32) + lane;
    float* mine = kept[thread / 32];

//: weights
        const int count = @IN@ - from < @PART@ ? @IN@ - from : @PART@;
        __syncthreads();
        for (int k = thread; k < count * @OUT@ / 4; k += 32 * @WARPS@)
            reinterpret_cast<float4*>(part)[k] =
                reinterpret_cast<const float4*>(own + @START@ + from * @OUT@)[k];
        @INPUTS@
        __syncthreads();

//: inputs
        for (int i = 0; i < count; ++i)
            mine[32 * i + lane] = row < rows
                ? inputs.data[static_cast<wp::uint64>(from + i) * rows + row] : 0.0f;

//: layer
    {
        float sums[@EACH@][8];
        #pragma unroll
        for (int o = 0; o < @EACH@; ++o)
            #pragma unroll
            for (int r = 0; r < 8; ++r)
                sums[o][r] = own[@BIAS@ + 32 * (o / 4) + 4 * group + o % 4];
        for (int from = 0; from < @IN@; from += @PART@) {
            @WEIGHTS@
            #pragma unroll 4
            for (int i = 0; i < count; ++i) {
                float x[8], w[@EACH@];
                const float* line = mine + 32 * (@FROM@ + i) + eight;
                *reinterpret_cast<float4*>(x) = *reinterpret_cast<const float4*>(line);
                *reinterpret_cast<float4*>(x + 4) = *reinterpret_cast<const float4*>(line + 4);
                #pragma unroll
                for (int o = 0; o < @EACH@; o += 4)
                    *reinterpret_cast<float4*>(w + o) = *reinterpret_cast<const float4*>(
                        part + @OUT@ * i + 8 * o + 4 * group);
                #pragma unroll
                for (int o = 0; o < @EACH@; ++o)
                    #pragma unroll
                    for (int r = 0; r < 8; ++r) sums[o][r] += w[o] * x[r];
            }
        }
        __syncwarp();
        #pragma unroll
        for (int o = 0; o < @EACH@; ++o)
            #pragma unroll
            for (int r = 0; r < 8; ++r)
                mine[32 * (32 * (o / 4) + 4 * group + o % 4) + eight + r] = act(sums[o][r]);
        __syncwarp();
    }

//: last
    {
        float sums[@OUT@];
        #pragma unroll
        for (int o = 0; o < @OUT@; ++o) sums[o] = own[@BIAS@ + o];
        for (int from = 0; from < @IN@; from += @PART@) {
            @WEIGHTS@
            for (int i = 0; i < count; ++i) {
                const float x = mine[32 * (@FROM@ + i) + lane];
                #pragma unroll
                for (int o = 0; o < @OUT@; ++o) sums[o] += x * part[@OUT@ * i + o];
            }
        }
        if (row < rows)
            #pragma unroll
            for (int o = 0; o < @REAL@; ++o)
                outputs.data[(static_cast<wp::uint64>(member) * @REAL@ + o) * rows + row] = sums[o];
    }

//: host
#else
    for (int row = 32 * @WARPS@ * block + thread; row < rows; row = rows) {
        float x[@WIDEST@], y[@WIDEST@];
        for (int i = 0; i < @COUNT@; ++i)
            x[i] = inputs.data[static_cast<wp::uint64>(i) * rows + row];

//: host_layer
        for (int o = 0; o < @OUT@; ++o) {
            y[o] = own[@BIAS@ + o];
            for (int i = 0; i < @IN@; ++i) y[o] += x[i] * own[@START@ + i * @OUT@ + o];
        }
        for (int o = 0; o < @OUT@; ++o) x[o] = @ACT@;

//: host_end
        for (int o = 0; o < @REAL@; ++o)
            outputs.data[(static_cast<wp::uint64>(member) * @REAL@ + o) * rows + row] = x[o];
    }
#endif
