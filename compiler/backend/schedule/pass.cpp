// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/schedule/pass.h"

#include <utility>

namespace dr::backend {

int64_t RowsScatter::names() const {
  const size_t count = std::visit(Overloaded{[](const RowsOfLeaf& by) { return by.columns.size(); },
                                             [](const SortedRows& by) { return by.places.size(); }},
                                  table);
  return static_cast<int64_t>(count);
}

ir::Dim RowsScatter::items(const ir::Extent& domain) const {
  const ir::Dim sources = sorted() == nullptr ? domain.w : domain.w * domain.h * domain.l;
  return sources * ir::Dim(names());
}

ScatterLowering ScatterPass::lowering() const {
  return std::visit(Overloaded{[](const ExactScatter&) { return ScatterLowering::Exact; },
                               [](const RowsScatter&) { return ScatterLowering::Rows; },
                               [](const AtomicScatter&) { return ScatterLowering::Atomic; },
                               [](const BinnedScatter&) { return ScatterLowering::Binned; }},
                    how);
}

const OwnRun* ScatterPass::own_run() const {
  return std::visit(
      Overloaded{[](const ExactScatter& by) -> const OwnRun* { return std::get_if<OwnFirstRun>(&by.first_run); },
                 [](const RowsScatter&) -> const OwnRun* { return nullptr; },
                 [](const auto& by) { return std::get_if<OwnRun>(&by.run); }},
      how);
}

const JoinedRun* ScatterPass::joined_run() const {
  return std::visit(
      Overloaded{[](const ExactScatter& by) -> const JoinedRun* { return std::get_if<JoinedFirstRun>(&by.first_run); },
                 [](const RowsScatter&) -> const JoinedRun* { return nullptr; },
                 [](const auto& by) { return std::get_if<JoinedRun>(&by.run); }},
      how);
}

const ActiveList* ScatterPass::active_list() const {
  const OwnRun* own = own_run();
  return own != nullptr && own->active ? &*own->active : nullptr;
}
ActiveList* ScatterPass::active_list() { return const_cast<ActiveList*>(std::as_const(*this).active_list()); }

const Clauses& ScatterPass::clauses() const {
  static const Clauses kNone;
  if (const JoinedRun* joined = joined_run()) return joined->clauses;
  const ActiveList* list = active_list();
  return list == nullptr ? kNone : list->clauses;
}

std::optional<PassId> ScatterPass::lister() const {
  if (const JoinedRun* joined = joined_run()) return joined->lister;
  const ActiveList* list = active_list();
  const PassId* by = list == nullptr ? nullptr : std::get_if<PassId>(&list->listed_by);
  return by == nullptr ? std::nullopt : std::optional(*by);
}

bool ScatterPass::leaves_list() const {
  return lister() && !(joined_run() != nullptr && (exact() == nullptr || runs_again()));
}

void ScatterPass::join_lister() {
  DR_ASSERT(active_list() != nullptr && lister());
  JoinedRun joined{std::move(active_list()->clauses), *lister()};
  std::visit(Overloaded{[&](ExactScatter& by) { by.first_run = JoinedFirstRun{std::move(joined)}; },
                        [](RowsScatter&) {}, [&](auto& by) { by.run = std::move(joined); }},
             how);
}

bool ScatterPass::relists() const {
  const auto* own = exact() == nullptr ? nullptr : std::get_if<OwnFirstRun>(&exact()->first_run);
  return own != nullptr && own->relists;
}

const std::vector<ir::ValueId>& ScatterPass::nonzero() const {
  static const std::vector<ir::ValueId> kNone;
  const auto* own = exact() == nullptr ? nullptr : std::get_if<OwnFirstRun>(&exact()->first_run);
  return own == nullptr ? kNone : own->nonzero;
}

bool ScatterPass::keeps_terms() const {
  const auto* joined = exact() == nullptr ? nullptr : std::get_if<JoinedFirstRun>(&exact()->first_run);
  return joined != nullptr && joined->keeps_terms;
}

bool ScatterPass::runs_again() const {
  const auto* joined = exact() == nullptr ? nullptr : std::get_if<JoinedFirstRun>(&exact()->first_run);
  return joined != nullptr && joined->again;
}

bool ScatterPass::asks() const {
  const auto* joined = exact() == nullptr ? nullptr : std::get_if<JoinedFirstRun>(&exact()->first_run);
  return joined != nullptr && joined->asks;
}

bool ScatterPass::joins_parts() const {
  return (exact() != nullptr && exact()->joins_parts) || (binned() != nullptr && binned()->joins_parts);
}

const std::string& ScatterPass::no_rows() const {
  static const std::string kNone;
  return exact() != nullptr ? exact()->no_rows : binned() != nullptr ? binned()->no_rows : kNone;
}

std::optional<LoopCut> ScatterPass::cut() const {
  return std::visit(
      Overloaded{[](const RowsScatter&) { return std::optional<LoopCut>(); }, [](const auto& by) { return by.cut; }},
      how);
}

PassKind Pass::kind() const {
  return std::visit(
      Overloaded{
          [](const MapPass&) { return PassKind::Map; }, [](const FragmentPass&) { return PassKind::Map; },
          [](const ReducePass&) { return PassKind::Reduce; }, [](const ScatterPass&) { return PassKind::Scatter; },
          [](const RasterPass&) { return PassKind::Raster; }, [](const DrawnRasterPass&) { return PassKind::Raster; }},
      of_kind);
}

std::optional<PassId> Pass::lister() const {
  const auto* scatter = as<ScatterPass>();
  return scatter == nullptr ? std::nullopt : scatter->lister();
}

const FaceSetup* Pass::setup() const {
  const auto* raster = as<RasterPass>();
  return raster == nullptr || !raster->setup ? nullptr : &*raster->setup;
}

namespace {

const char* lowering_name(ScatterLowering lowering) {
  switch (lowering) {
    case ScatterLowering::Exact: return "scatter exact";
    case ScatterLowering::Rows: return "scatter rows";
    case ScatterLowering::Atomic: return "scatter atomic";
    case ScatterLowering::Binned: return "scatter binned";
  }
  return "";
}

}  // namespace

const char* kind_name(const Pass& pass) {
  return std::visit(Overloaded{[](const MapPass&) { return "compute"; }, [](const FragmentPass&) { return "fragment"; },
                               [](const ReducePass&) { return "reduce"; },
                               [](const ScatterPass& scatter) { return lowering_name(scatter.lowering()); },
                               [](const RasterPass&) { return "raster compute"; },
                               [](const DrawnRasterPass&) { return "raster hardware"; }},
                    pass.of_kind);
}

}  // namespace dr::backend
