// SPDX-License-Identifier: Apache-2.0

//: load4
#if defined(__CUDA_ARCH__)
    const float4 q = __ldg(reinterpret_cast<const float4*>(data.data) + i);
    return wp::vec_t<4, wp::float32>(q.x, q.y, q.z, q.w);
#else
    return data.data[i];
#endif

//: store4
#if defined(__CUDA_ARCH__)
    reinterpret_cast<float4*>(data.data)[i] = make_float4(a, b, c, d);
#else
    data.data[i] = wp::vec_t<4, wp::float32>(a, b, c, d);
#endif
