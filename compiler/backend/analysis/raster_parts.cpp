// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/raster_parts.h"

#include "compiler/ir/raster.h"

namespace dr::backend {

RasterParts raster_parts(const ir::Op& op) {
  RasterParts p;
  p.count = static_cast<size_t>(op.attrs.ints[0]);
  p.listed = ir::lists_faces(op.attrs);
  const auto fields = static_cast<size_t>(op.attrs.ints[1]), corners = static_cast<size_t>(op.attrs.ints[2]);
  p.fields.assign(op.operands.begin(), op.operands.begin() + static_cast<ptrdiff_t>(fields));
  p.corners.assign(op.operands.begin() + static_cast<ptrdiff_t>(fields),
                   op.operands.begin() + static_cast<ptrdiff_t>(fields + corners));
  p.cull = op.operands.back();
  p.w = op.attrs.dims[0];
  p.h = op.attrs.dims[1];
  p.l = op.attrs.dims[2];
  p.faces = op.attrs.dims[3];
  return p;
}

}  // namespace dr::backend
