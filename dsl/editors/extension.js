// SPDX-License-Identifier: Apache-2.0
// Starts `drc lsp` for programs that are open in Visual Studio Code.
const { workspace } = require('vscode');
const { LanguageClient } = require('vscode-languageclient/node');

let client;

exports.activate = () => {
  const settings = workspace.getConfiguration('dressi');
  const server = { command: settings.get('drc'), args: ['lsp'] };
  client = new LanguageClient('dressi', 'Dressi', server, {
    documentSelector: [{ scheme: 'file', language: 'dressi' }, { scheme: 'untitled', language: 'dressi' }],
    initializationOptions: { includeDirs: settings.get('includeDirs'), defines: settings.get('defines') },
  });
  return client.start();
};

exports.deactivate = () => client && client.stop();
