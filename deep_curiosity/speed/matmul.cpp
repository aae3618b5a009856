// Products of float32 matrices by torch's own kernel, without what stands around it in torch.bmm:
// descriptions of the operands, made and freed at every call, take longer than a small product.

#include <ATen/cpu/vec/vec.h>
#include <ATen/native/CPUBlas.h>
#include <torch/csrc/inductor/aoti_torch/c/shim.h>

#include <algorithm>
#include <vector>

namespace deep_curiosity {
namespace {

constexpr int64_t LINE = 16;  // floats of a line of the cache

struct alignas(LINE * sizeof(float)) Line {
  float values[LINE];
};

void transpose(
    const float* from, int64_t from_stride, float* to, int64_t to_stride, int64_t rows,
    int64_t columns) {
  for (int64_t row = 0; row < rows; row += LINE) {
    for (int64_t column = 0; column < columns; column += LINE) {
      const float* source = from + row * from_stride + column;
      float* target = to + column * to_stride + row;
      const int height = std::min(LINE, rows - row), width = std::min(LINE, columns - column);
      if (height == LINE && width == LINE) {
        at::vec::transpose_mxn<float, LINE, LINE>(source, from_stride, target, to_stride);
      } else {
        at::vec::transpose_mxn<float>(source, from_stride, target, to_stride, height, width);
      }
    }
  }
}

// A matrix, or a batch of them, where it lies in memory.
struct Matrices {
  int64_t num, rows, columns;
  int64_t between, between_rows, between_columns;  // strides
  float* data;

  explicit Matrices(AtenTensorHandle tensor) {
    int64_t dim, *sizes, *strides;
    void* start;
    aoti_torch_get_dim(tensor, &dim);
    aoti_torch_get_sizes(tensor, &sizes);
    aoti_torch_get_strides(tensor, &strides);
    aoti_torch_get_data_ptr(tensor, &start);
    num = dim == 3 ? sizes[0] : 1;
    between = dim == 3 ? strides[0] : 0;
    rows = sizes[dim - 2], columns = sizes[dim - 1];
    between_rows = strides[dim - 2], between_columns = strides[dim - 1];
    data = static_cast<float*>(start);
  }

  bool lie_in_rows() const { return between_columns == 1; }
  bool lie_in_columns() const { return between_rows == 1; }
};

// One matrix row by row, as the kernel reads it: where it lies, or copied from its columns.
struct Rows {
  const float* data;
  int64_t stride;

  Rows(const Matrices& all, int64_t index, std::vector<Line>& memory)
      : data(all.data + index * all.between), stride(all.between_rows) {
    if (!all.lie_in_rows()) {
      // a line more than it takes: rows apart by a power of two share places in the cache
      const int64_t lines = (all.columns + LINE - 1) / LINE + 1;
      memory.resize(std::max<size_t>(memory.size(), all.rows * lines));
      stride = lines * LINE;
      transpose(data, all.between_columns, memory[0].values, stride, all.columns, all.rows);
      data = memory[0].values;
    }
  }
};

// A product written to where it shall lie, by torch itself where the kernel is not for it.
template <typename Torchs>
AOTITorchError product(
    Torchs torchs, AtenTensorHandle out_tensor, AtenTensorHandle left_tensor,
    AtenTensorHandle right_tensor) {
  const Matrices out(out_tensor), left(left_tensor), right(right_tensor);
  const bool lie_well = out.lie_in_rows() && (left.lie_in_rows() || left.lie_in_columns()) &&
                        (right.lie_in_rows() || right.lie_in_columns());
  const bool is_empty = out.rows * out.columns * left.columns == 0;
  int32_t dtype;
  aoti_torch_get_dtype(left_tensor, &dtype);
  if (dtype != aoti_torch_dtype_float32() || !lie_well || is_empty) {
    return torchs(out_tensor, left_tensor, right_tensor);
  }
  static thread_local std::vector<Line> left_memory, right_memory;
  for (int64_t index = 0; index < out.num; ++index) {
    const Rows a(left, index, left_memory), b(right, index, right_memory);
    at::native::cpublas::brgemm(
        out.rows, out.columns, left.columns, a.stride, b.stride, out.between_rows,
        /*add_C=*/false, a.data, b.data, out.data + index * out.between);
  }
  return AOTI_TORCH_SUCCESS;
}

}  // namespace
}  // namespace deep_curiosity

// From here on what asks torch asks for the above.
#define aoti_torch_cpu_bmm_out(...) deep_curiosity::product(aoti_torch_cpu_bmm_out, __VA_ARGS__)
#define aoti_torch_cpu_mm_out(...) deep_curiosity::product(aoti_torch_cpu_mm_out, __VA_ARGS__)
