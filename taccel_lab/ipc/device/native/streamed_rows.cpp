// SPDX-License-Identifier: Apache-2.0

//: warp_width
#if defined(__CUDA_ARCH__)
    return 32;
#else
    return 1;
#endif

//: memory_of
    return memory + @STAGE_BYTES@ * static_cast<wp::uint64>(stages * warp);

//: begin
#if defined(__CUDA_ARCH__)
    @COPY@
    __syncwarp();
    for (int g = 0; g < stages - 1; ++g)
        copy(g);
#endif

//: end_stream
#if defined(__CUDA_ARCH__)
    asm volatile("cp.async.wait_all;" ::: "memory");
#endif

//: slice_product
    const int place = task & 31;
    const double* const u = x.data;
    double sums[4] = {};
#if defined(__CUDA_ARCH__)
    @COPY@
    const unsigned int base = 4 * place + static_cast<unsigned int>(
        __cvta_generic_to_shared(reinterpret_cast<char*>(memory)));
    #pragma unroll 1
    for (int g = group; g < group + count / 4; ++g) {
        if (stages == 2)
            asm volatile("cp.async.wait_group 0;" ::: "memory");
        else
            asm volatile("cp.async.wait_group 2;" ::: "memory");
        // What one lane copied is for all to see, and nobody reads the stage that is copied into.
        __syncwarp();
        const unsigned int from = base + 2048 * (g & (stages - 1));
        float across[12];
        double own[12];
        #pragma unroll
        for (int i = 0; i < 4; ++i) {
            int column;
            asm volatile("ld.shared.s32 %0, [%1];" : "=r"(column) : "r"(from + 1536 + 128 * i));
            #pragma unroll
            for (int c = 0; c < 3; ++c)
                asm volatile("ld.global.f64 %0, [%1];"
                             : "=d"(own[3 * i + c]) : "l"(u + 3 * column + c));
        }
        #pragma unroll
        for (int i = 0; i < 12; ++i)
            asm volatile("ld.shared.f32 %0, [%1];" : "=f"(across[i]) : "r"(from + 128 * i));
        copy(g + stages - 1);
        #pragma unroll
        for (int i = 0; i < 12; ++i)
            sums[i / 3] += across[i] * own[i];
    }
#else
    const float* const row = packed.data + 3 * (first + 128 * group) + place;
    const int* const column = columns.data + first + 128 * group + place;
    for (int k = 0; k < count; ++k)
        for (int c = 0; c < 3; ++c)
            sums[k % 4] += row[96 * k + 32 * c] * u[3 * column[32 * k] + c];
#endif
    return (sums[0] + sums[1]) + (sums[2] + sums[3]);

//: copy
// Copies of group g, 16 bytes at a time; every lane states the end of each, with copies or without.
    const auto copy = [&](const int g) {
        if (g < groups) {
            const int at = first + 128 * g;
            const int place = threadIdx.x & 31;
            const char* const rows =
                reinterpret_cast<const char*>(packed.data + 3 * at) + 16 * place;
            const char* const column =
                reinterpret_cast<const char*>(columns.data + at) + 16 * place;
            const unsigned int to = static_cast<unsigned int>(__cvta_generic_to_shared(
                reinterpret_cast<char*>(memory) + 2048 * (g & (stages - 1)) + 16 * place));
            asm volatile(
                "cp.async.cg.shared.global [%0], [%1], 16;"
                "cp.async.cg.shared.global [%0 + 512], [%1 + 512], 16;"
                "cp.async.cg.shared.global [%0 + 1024], [%1 + 1024], 16;"
                "cp.async.cg.shared.global [%0 + 1536], [%2], 16;" ::
                "r"(to), "l"(rows), "l"(column) : "memory");
        }
        asm volatile("cp.async.commit_group;" ::: "memory");
    };
