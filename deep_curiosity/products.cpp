// Products of float32 matrices by torch's own kernel, without what stands around it in torch.bmm:
// descriptions of the operands, made and freed at every call, take longer than a small product.

#include <ATen/cpu/vec/vec.h>
#include <ATen/native/CPUBlas.h>
#include <torch/csrc/inductor/aoti_torch/c/shim.h>

#include <algorithm>
#include <vector>

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
  int64_t dim, num, rows, columns;
  int64_t between, between_rows, between_columns;  // strides
  const float* data;

  explicit Matrices(AtenTensorHandle tensor) {
    int64_t *sizes, *strides;
    void* start;
    aoti_torch_get_dim(tensor, &dim);
    aoti_torch_get_sizes(tensor, &sizes);
    aoti_torch_get_strides(tensor, &strides);
    aoti_torch_get_data_ptr(tensor, &start);
    num = dim == 3 ? sizes[0] : 1;
    between = dim == 3 ? strides[0] : 0;
    rows = sizes[dim - 2], columns = sizes[dim - 1];
    between_rows = strides[dim - 2], between_columns = strides[dim - 1];
    data = static_cast<const float*>(start);
  }
};

// One matrix row by row, as the kernel reads it: where it lies, or copied from there.
struct Rows {
  const float* data;
  int64_t stride;

  Rows(const Matrices& all, int64_t index, std::vector<Line>& memory)
      : data(all.data + index * all.between), stride(all.between_rows) {
    if (all.between_columns != 1) {
      copy(all, memory);
    }
  }

 private:
  void copy(const Matrices& all, std::vector<Line>& memory) {
    // a line more than it takes: rows apart by a power of two share places in the cache
    const int64_t lines = (all.columns + LINE - 1) / LINE + 1;
    memory.resize(std::max<size_t>(memory.size(), all.rows * lines));
    float* copied = memory[0].values;
    stride = lines * LINE;
    if (all.between_rows == 1) {
      transpose(data, all.between_columns, copied, stride, all.columns, all.rows);
    } else {
      for (int64_t row = 0; row < all.rows; ++row) {
        for (int64_t column = 0; column < all.columns; ++column) {
          copied[row * stride + column] =
              data[row * all.between_rows + column * all.between_columns];
        }
      }
    }
    data = copied;
  }
};

// What compiled code calls for `deep_curiosity::product`; torch gives it its name.
AOTITorchError aoti_torch_cpu_product(
    AtenTensorHandle left_tensor, AtenTensorHandle right_tensor, AtenTensorHandle* product) {
  const Matrices left(left_tensor), right(right_tensor);
  const int64_t rows = left.rows, columns = right.columns;
  const int64_t sizes[] = {left.num, rows, columns}, strides[] = {rows * columns, columns, 1};
  const int64_t skipped = 3 - left.dim;
  const AOTITorchError error = aoti_torch_empty_strided(
      left.dim, sizes + skipped, strides + skipped, aoti_torch_dtype_float32(),
      aoti_torch_device_type_cpu(), /*device_index=*/0, product);
  if (error != AOTI_TORCH_SUCCESS) {
    return error;
  }
  void* start;
  aoti_torch_get_data_ptr(*product, &start);
  static thread_local std::vector<Line> left_memory, right_memory;
  for (int64_t index = 0; index < left.num; ++index) {
    const Rows a(left, index, left_memory), b(right, index, right_memory);
    at::native::cpublas::brgemm(
        rows, columns, left.columns, a.stride, b.stride, columns, /*add_C=*/false, a.data, b.data,
        static_cast<float*>(start) + index * rows * columns);
  }
  return AOTI_TORCH_SUCCESS;
}

}  // namespace
